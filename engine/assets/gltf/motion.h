// Collects what moves in a scene while its nodes and meshes are read.
#pragma once

#include "engine/assets/gltf/file/model.h"
#include "engine/scene/description.h"
#include "engine/scene/motion/motion.h"

#include <cstdint>
#include <map>
#include <span>
#include <vector>

namespace raynest::gltf {

/// Makes the tables of a scene's motion. Without animations it does nothing.
class MotionWriter {
public:
    /// `model` has its poses separated (skins.h). In a scene with an origin no vertices move.
    MotionWriter(const Model& model, SceneDescription& scene);

    /// True if the place of a node in the scene changes.
    [[nodiscard]] bool moves(std::uint32_t node) const { return !moves_.empty() && moves_[node]; }
    /// True if the vertices of a mesh move.
    [[nodiscard]] bool deforms(std::size_t mesh) const {
        return !deforms_.empty() && deforms_[mesh];
    }

    // The parts of a mesh that deforms, one after the other. Numbers are those of the file, before
    // targets and joints.
    void begin_mesh(std::uint32_t mesh);
    /// Bytes that begin_part() takes: each part has all targets of its mesh.
    [[nodiscard]] std::uint64_t part_bytes() const {
        return tables_.meshes.back().weight_count * sizeof(MovedTarget);
    }
    void begin_part();
    void set_positions(std::span<const float> values);
    void set_normals(std::span<const float> values);
    void set_tangents(std::span<const float> values);
    void set_target(std::size_t target, Morphed attribute, std::span<const float> differences);
    /// `count` joints of each vertex, a multiple of 4, and their weights.
    void set_influences(std::uint32_t count, std::span<const std::uint32_t> joints,
                        std::span<const float> weights);
    /// `vertices` as they came into the scene; 0: the part is not in it.
    void end_part(std::uint32_t vertices);
    /// The joints of a mesh's skin: what maps from the mesh to each of them.
    void set_joints(std::uint32_t mesh, std::span<const Matrix> binds);

    /// A placement in the root.
    void place(std::uint32_t outermost, std::uint32_t node, std::uint32_t object,
               const Matrix& to_node);
    void place_camera(std::uint32_t camera, std::uint32_t node);
    void place_light(std::uint32_t light, std::uint32_t node);

    /// Writes the tables into the scene. Call it last.
    void finish();

private:
    std::uint32_t number_of(std::uint32_t node);
    std::uint32_t add_floats(std::span<const float> values);

    const Model& model_;
    SceneDescription& scene_;
    MotionTables tables_;
    std::vector<bool> moves_;                         ///< by node; empty: nothing moves
    std::vector<bool> deforms_;                       ///< by mesh; empty: none does
    std::vector<std::uint32_t> parents_;              ///< by node
    std::vector<std::uint32_t> numbers_;              ///< by node: in the tables
    std::vector<std::vector<std::uint32_t>> places_;  ///< by entry of tables_.meshes
    std::map<std::uint32_t, std::uint32_t> meshes_;   ///< mesh -> entry
};

}  // namespace raynest::gltf
