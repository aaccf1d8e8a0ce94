// The alpha test of alpha_mask behind a live pointer.
#pragma once

#include "engine/intersectors/texture.h"
#include "tests/bench/control/pointer.h"

namespace raynest {

struct PointerAlpha : PointerTested {
    static constexpr const char* text = "control: the alpha test through a live pointer";
    struct Params {};
    static constexpr auto params = std::tuple{};
    PointerAlpha(const SceneView& scene, const Params&) : PointerTested(alpha, &scene) {}

private:
    static bool is_solid(const void* context, const ObjectRecord* object, const Surface& surface) {
        const SceneView& scene = *static_cast<const SceneView*>(context);
        const GeometryRecord& geometry = scene.geometry_of(*object, surface.prim);
        if (geometry.material == no_id) return true;
        const MaterialRecord& material = scene.materials[geometry.material];
        if (material.alpha_mode == AlphaMode::opaque) return true;
        const float least = material.alpha_mode == AlphaMode::blend ? 0.5F : material.cutoff;
        return surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v) >=
               least;
    }
    static inline constinit SurfaceTest volatile alpha = is_solid;
};

}  // namespace raynest
