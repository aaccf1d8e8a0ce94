// The paper's first use case: texels with low alpha are holes that the ray passes through. `auto`
// takes it where a scene has MASK materials; with BLEND alone it takes opaque, and nothing has
// holes.
#pragma once

#include "engine/intersectors/alpha_test.h"
#include "engine/intersectors/interface.h"

#include <tuple>

namespace raynest {

/// Hits MASK materials where alpha >= their alphaCutoff (or `cutoff`, if set), BLEND materials
/// where alpha >= 0.5, and OPAQUE ones everywhere.
struct AlphaMask {
    static constexpr const char* text =
        "textures' alpha cuts holes (glTF MASK and BLEND materials)";
    struct Params {
        float cutoff = -1;
    };
    static constexpr auto params = std::tuple{
        param("cutoff", &Params::cutoff, -1.0F, 1.0F,
              "least alpha that counts as a hit on MASK materials; below 0: the material's own")};

    RAYNEST_FN AlphaMask(const SceneView& view, const Params& values)
        : scene(view),
          cutoff(values.cutoff) {}

    RAYNEST_INLINE auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([&](const Surface& surface) {
            return ray.object == nullptr || is_solid(*ray.object, surface, block_of(triangle));
        });
        return hits;
    }

    [[nodiscard]] Refusal refusal(const RayView& ray, const Surface& surface) const {
        const GeometryRecord& geometry = scene.geometry_of(*ray.object, surface.prim);
        const MaterialRecord& material = scene.materials[geometry.material];
        return {"alpha",
                surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v),
                "below", least_alpha(material)};
    }

private:
    /// Returns the least alpha that counts as a hit on a material that is not opaque.
    [[nodiscard]] RAYNEST_FN float least_alpha(const MaterialRecord& material) const {
        return material.alpha_mode == AlphaMode::blend ? 0.5F
               : cutoff >= 0                           ? cutoff
                                                       : material.cutoff;
    }

    // Kept out of line: few candidates get here, and the test that every triangle needs must stay
    // inlined in the traversal (measured in batches: 1.05 to 1.1).
    [[nodiscard]] RAYNEST_NOINLINE bool is_solid(const ObjectRecord& object, const Surface& surface,
                                                 const TriangleBlock* block) const {
        return has_alpha_of(scene, object, surface, block,
                            [&](const MaterialRecord& material)
                                RAYNEST_INLINE_LAMBDA { return least_alpha(material); });
    }

    const SceneView& scene;
    float cutoff;
};

}  // namespace raynest
