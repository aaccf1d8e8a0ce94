// The paper's first use case: texels with low alpha are holes that the ray passes through.
#pragma once

#include "engine/intersectors/interface.h"
#include "engine/intersectors/texture.h"

#include <tuple>

namespace raynest {

/// MASK materials are hit where alpha >= their alphaCutoff (or `cutoff`, when set), BLEND materials
/// where alpha >= 0.5, OPAQUE ones everywhere.
struct AlphaMask {
    static constexpr const char* text =
        "textures' alpha cuts holes (glTF MASK and BLEND materials)";
    struct Params {
        float cutoff = -1;
    };
    static constexpr auto params = std::tuple{
        param("cutoff", &Params::cutoff, -1.0F, 1.0F,
              "least alpha that is hit, for MASK materials; below 0: each material's own")};

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

private:
    /// Of a triangle by itself none: the reference finds texture coordinates by index.
    RAYNEST_INLINE static const TriangleBlock* block_of(const TriangleLike auto& triangle) {
        if constexpr (requires { triangle.block; }) return triangle.block;
        return nullptr;
    }

    // Out of line, and only this: few candidates come so far, and the test for all triangles is to
    // stay in the traversal (measured in batches: 1.05 to 1.1).
    [[nodiscard]] RAYNEST_NOINLINE bool is_solid(const ObjectRecord& object, const Surface& surface,
                                                 const TriangleBlock* block) const {
        const GeometryRecord& geometry = scene.geometry_of(object, surface.prim);
        if (geometry.material == no_id) return true;
        const MaterialRecord& material = scene.materials[geometry.material];
        if (material.alpha_mode == AlphaMode::opaque) return true;
        const float least = material.alpha_mode == AlphaMode::blend ? 0.5F
                            : cutoff >= 0                           ? cutoff
                                                                    : material.cutoff;
        // Most triangles of a leaf lie inside its outline or outside of it: no look at the texture.
        const Opacity opacity = scene.opacity_of(geometry, surface.prim);
        if (opacity.is_all_at_least(least)) return true;
        if (opacity.is_all_below(least)) return false;
        const Vec2* const corners = block != nullptr && material.texture != no_id
                                        ? corner_texcoords(scene, object, *block, surface.lane)
                                        : nullptr;
        return surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v,
                             corners) >= least;
    }

    const SceneView& scene;
    float cutoff;
};

}  // namespace raynest
