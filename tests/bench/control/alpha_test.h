// The alpha test that the controls share: compiled in by one, called through a pointer by the
// other. raynest-bench holds both to the answers of alpha_mask.
#pragma once

#include "engine/geometry/intersection.h"
#include "engine/intersectors/texture.h"

namespace raynest {

inline bool passes_alpha(const SceneView& scene, const ObjectRecord& object,
                         const Surface& surface) {
    const GeometryRecord& geometry = scene.geometry_of(object, surface.prim);
    if (geometry.material == no_id) return true;
    const MaterialRecord& material = scene.materials[geometry.material];
    if (material.alpha_mode == AlphaMode::opaque) return true;
    const float least = material.alpha_mode == AlphaMode::blend ? 0.5F : material.cutoff;
    return surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v) >= least;
}

}  // namespace raynest
