// Rounds placements to float32 with the least loss of digits.
//
// Transforms are composed in double, and the scene's origin is subtracted before they are rounded.
// Vertices are already float32 in the file. A ray that enters a mesh whose vertices lie far from
// zero would be rounded as coarsely. So in a scene with an origin such a mesh is moved to its own
// centre, and its placements move it back.
#pragma once

#include "engine/assets/gltf/file/model.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest::gltf {

/// Returns what maps the world of a file, in which y points up, to the scene.
[[nodiscard]] Matrix world_to_scene(UpAxis up, const WorldPoint& origin);

/// Turns the world to model.up and subtracts the origin from it: in the transform of every root and
/// of every other node without a parent.
void move_world(Model& model, const WorldPoint& origin);

class Placements {
public:
    /// `meshes` are the objects [0, meshes.size()). If there is an origin, meshes far from zero are
    /// moved to their centres.
    Placements(std::span<ObjectDescription> meshes, const WorldPoint& origin);

    /// Adds the next object, which holds placements of earlier ones.
    void add(const ObjectDescription& object);
    /// Returns the rounded transform of a placement of `object`. Entries that do not fit a float
    /// become infinite and are refused later.
    [[nodiscard]] Transform round(std::uint32_t object, const Matrix& to_parent);
    /// Takes a placement in the scene's own space: what float32 cannot tell apart there, rays
    /// cannot meet either.
    void place_in_scene(std::uint32_t object, const Matrix& to_scene);
    /// Returns the largest distance by which round() moved a vertex within its parent, or float32
    /// moves one in the scene.
    [[nodiscard]] double rounding() const { return rounding_; }
    /// The largest distance by which the file's vertices may be off in the scene (half_step()).
    [[nodiscard]] double file_rounding() const { return file_rounding_; }

    /// Returns the map to the parent of an object as it is now: its centre is moved back.
    [[nodiscard]] Matrix exact_matrix(std::uint32_t object, const Matrix& to_parent) const;

private:
    /// What is known of an object's vertices, in its space.
    struct Extent {
        WorldPoint centre{};            ///< was subtracted from a mesh's vertices
        double reach = 0;               ///< greatest distance of its parts from zero
        glm::dvec3 lower{0}, upper{0};  ///< box; both 0 where it has no vertices
        double half_step = 0;           ///< half a step of its vertices as the file has them
    };
    std::vector<Extent> extents_;  ///< by object
    double rounding_ = 0;
    double file_rounding_ = 0;
};

}  // namespace raynest::gltf
