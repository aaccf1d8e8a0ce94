// Morph targets and skins, evaluated in the pose of the file.
//
// A mesh is deformed at import: first by its morph targets, then by its skin (glTF 2.0, 3.7.2.2 and
// 3.7.3). What animations need to do so again goes into the scene (motion.h). The joints of a
// skinned mesh place it, not its node: its vertices are in the scene's space.
#pragma once

#include "engine/assets/gltf/budget.h"
#include "engine/assets/gltf/file/model.h"
#include "engine/assets/gltf/motion.h"

#include <functional>
#include <string>
#include <vector>

namespace raynest::gltf {

/// Gives every node that has a skin, or morph weights of its own, a posed mesh at the end of
/// model.meshes. Nodes with equal mesh, skin and weights share one.
void separate_poses(Model& model);

/// Reads an accessor for the vertices in use, after checking its length. Messages contain `name`
/// and the mesh.
using ReadAttribute =
    std::function<Result<std::vector<float>>(const Accessor&, bool type_allowed, const char* name)>;

/// The primitive whose vertices are being read, and the (posed) mesh that it belongs to.
struct Deformed {
    const std::string& where;  ///< names the mesh in messages
    const Mesh& mesh;
    const Primitive& primitive;
    ReadAttribute read;
    MotionWriter* motion = nullptr;  ///< to note them in, if they move
};

class Deformer {
public:
    Deformer(const Model& model, Budget& budget)
        : model_(model),
          budget_(budget),
          joints_(model.skins.size()),
          binds_(model.skins.size()) {}

    /// Adds the weighted differences of the targets to `values`, `width` per vertex.
    Result<void> morph(const Deformed& vertices, Morphed attribute, std::size_t width,
                       std::vector<float>& values);
    /// Moves positions, normals and tangents by the joints of mesh.skin, into the scene's space.
    /// Normals and tangents become unit vectors.
    Result<void> skin(const Deformed& vertices, GeometryDescription& geometry);

private:
    /// Returns one map per joint, from the mesh's space at binding to the scene's; never empty.
    Result<std::span<const Matrix>> joint_maps(std::uint32_t skin);
    Result<std::vector<float>> inverse_bind_matrices(const Skin& skin);

    const Model& model_;
    Budget& budget_;
    std::vector<Matrix> to_world_;             ///< by node; empty until a skin is read
    std::vector<std::vector<Matrix>> joints_;  ///< by skin; empty until it is read
    std::vector<std::vector<Matrix>> binds_;   ///< likewise, from the mesh's space to the joints'
};

}  // namespace raynest::gltf
