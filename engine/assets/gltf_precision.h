// Placements in float32, with as few digits lost as can be.
//
// Transforms are composed in double, and the scene's origin is subtracted before they are rounded.
// Vertices are float32 in the file already. Where they lie far from zero, a ray that enters the
// mesh would be rounded as coarsely; so in a scene with an origin such a mesh is moved to its own
// centre, and its placements carry the way back.
#pragma once

#include "engine/assets/gltf_model.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest::gltf {

/// Subtracts the origin from the place of every node that has no parent, and of every root.
void move_world(Model& model, const WorldPoint& origin);

class Placements {
public:
    /// `meshes` are the objects [0, meshes.size()); those far from zero are moved to their centres
    /// if there is an origin.
    Placements(std::span<ObjectDescription> meshes, const WorldPoint& origin);

    /// Takes the next object, which holds placements of those before it.
    void add(const ObjectDescription& object);
    /// The transform of a placement of `object`; entries that do not fit a float become infinite
    /// and are refused later.
    [[nodiscard]] Transform round(std::uint32_t object, const Matrix& to_parent);
    /// The largest distance by which round() moved a vertex, within its parent.
    [[nodiscard]] double rounding() const { return rounding_; }

private:
    std::vector<WorldPoint> centres_;  ///< by object; that of `add` are 0
    std::vector<double> reaches_;      ///< by object: distance of its farthest part from its zero
    double rounding_ = 0;
};

}  // namespace raynest::gltf
