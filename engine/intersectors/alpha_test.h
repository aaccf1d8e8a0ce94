// The test of intersectors that look at alpha: is a candidate's alpha at least so much?
#pragma once

#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"
#include "engine/intersectors/texture.h"

namespace raynest {

/// Returns the triangle's leaf block; null for the reference's single triangles, whose texture
/// coordinates are found by index.
RAYNEST_INLINE const TriangleBlock* block_of(const TriangleLike auto& triangle) {
    if constexpr (requires { triangle.block; }) return triangle.block;
    return nullptr;
}

/// True on opaque materials, and where alpha is at least `least_of(material)` on others.
template <class Least>
RAYNEST_INLINE bool has_alpha_of(const SceneView& scene, const ObjectRecord& object,
                                 const Surface& surface, const TriangleBlock* block,
                                 Least&& least_of) {
    const GeometryRecord& geometry = scene.geometry_of(object, surface.prim);
    if (geometry.material == no_id) return true;
    const MaterialRecord& material = scene.materials[geometry.material];
    if (material.alpha_mode == AlphaMode::opaque) return true;
    const float least = least_of(material);
    // Skip the texture for most triangles of a leaf: they are wholly inside its outline or
    // outside it.
    const Opacity opacity = scene.opacity_of(geometry, surface.prim);
    if (opacity.is_all_at_least(least)) return true;
    if (opacity.is_all_below(least)) return false;
    const Vec2* const corners = block != nullptr && has_texture(geometry, material)
                                    ? corner_texcoords(scene, object, *block, surface.lane)
                                    : nullptr;
    return surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v, corners) >=
           least;
}

}  // namespace raynest
