// Rounds placements to float32 with the least loss of digits.
//
// Transforms are composed in double, and the scene's origin is subtracted before they are rounded.
// Vertices are already float32 in the file. A ray that enters a mesh whose vertices lie far from
// zero would be rounded as coarsely. So in a scene with an origin such a mesh is moved to its own
// centre, and its placements move it back.
#pragma once

#include "engine/assets/gltf_model.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest::gltf {

/// Subtracts the origin from the transform of every root and of every other node without a parent.
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
    /// Returns the largest distance by which round() moved a vertex, within its parent.
    [[nodiscard]] double rounding() const { return rounding_; }

private:
    std::vector<WorldPoint> centres_;  ///< by object; 0 for added objects
    std::vector<double> reaches_;      ///< by object: greatest distance of its parts from zero
    double rounding_ = 0;
};

}  // namespace raynest::gltf
