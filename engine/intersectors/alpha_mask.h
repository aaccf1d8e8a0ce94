// The paper's first use case: texels with low alpha are holes that the ray passes through.
#pragma once

#include "engine/intersectors/interface.h"
#include "engine/intersectors/texture.h"

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
    /// Returns the triangle's leaf block; null for the reference's single triangles, whose texture
    /// coordinates are found by index.
    RAYNEST_INLINE static const TriangleBlock* block_of(const TriangleLike auto& triangle) {
        if constexpr (requires { triangle.block; }) return triangle.block;
        return nullptr;
    }

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
        const GeometryRecord& geometry = scene.geometry_of(object, surface.prim);
        if (geometry.material == no_id) return true;
        const MaterialRecord& material = scene.materials[geometry.material];
        if (material.alpha_mode == AlphaMode::opaque) return true;
        const float least = least_alpha(material);
        // Skip the texture for most triangles of a leaf: they are wholly inside its outline or
        // outside it.
        const Opacity opacity = scene.opacity_of(geometry, surface.prim);
        if (opacity.is_all_at_least(least)) return true;
        if (opacity.is_all_below(least)) return false;
        const Vec2* const corners = block != nullptr && has_texture(geometry, material)
                                        ? corner_texcoords(scene, object, *block, surface.lane)
                                        : nullptr;
        return surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v,
                             corners) >= least;
    }

    const SceneView& scene;
    float cutoff;
};

}  // namespace raynest
