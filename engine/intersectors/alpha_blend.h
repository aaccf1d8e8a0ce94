// Stochastic transparency (Enderton et al., 2010): a surface with alpha 0.3 stops three rays of
// ten. The mean over many rays of a pixel is what blending sorted layers would give.
#pragma once

#include "engine/intersectors/alpha_test.h"
#include "engine/intersectors/interface.h"

#include <bit>
#include <tuple>

namespace raynest {

/// Hits MASK materials as AlphaMask does, and BLEND materials with a probability of alpha: a hash
/// of the ray and the triangle decides, so the same ray always finds the same.
struct AlphaBlend {
    static constexpr const char* text =
        "alpha of BLEND materials is the chance of a hit; MASK materials have holes";
    struct Params {
        float cutoff = -1;
        std::uint32_t seed = 0;
    };
    static constexpr auto params = std::tuple{
        param("cutoff", &Params::cutoff, -1.0F, 1.0F,
              "least alpha that counts as a hit on MASK materials; below 0: the material's own"),
        param("seed", &Params::seed, 0U, 0xFFFFFFFFU, "another number draws other hits")};

    RAYNEST_FN AlphaBlend(const SceneView& view, const Params& values)
        : scene(view),
          cutoff(values.cutoff),
          seed(values.seed) {}

    RAYNEST_INLINE auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([&](const Surface& surface) {
            return ray.object == nullptr ||
                   is_solid(*ray.object, surface, block_of(triangle), *ray.world, ray.path);
        });
        return hits;
    }

    [[nodiscard]] Refusal refusal(const RayView& ray, const Surface& surface) const {
        const GeometryRecord& geometry = scene.geometry_of(*ray.object, surface.prim);
        const MaterialRecord& material = scene.materials[geometry.material];
        return {"alpha",
                surface_alpha(scene, geometry, material, surface.prim, surface.u, surface.v),
                "below", least_alpha(material, *ray.world, ray.path, surface.prim)};
    }

private:
    RAYNEST_FN static std::uint32_t mix(std::uint32_t x, std::uint32_t more) {
        x = (x ^ more) * 0x9E3779B1U;
        x ^= x >> 15;
        x *= 0x85EBCA77U;
        return x ^ (x >> 13);
    }

    /// A number in (0, 1] for a ray and a triangle; alpha 0 is never a hit, alpha 1 always.
    [[nodiscard]] RAYNEST_FN float threshold(const Ray& ray, std::uint64_t path,
                                             std::uint32_t triangle) const {
        std::uint32_t hash = seed + 0x2545F491U;
        for (int axis = 0; axis < 3; ++axis) {
            hash = mix(hash, std::bit_cast<std::uint32_t>(ray.origin[axis]));
            hash = mix(hash, std::bit_cast<std::uint32_t>(ray.direction[axis]));
        }
        hash = mix(hash, static_cast<std::uint32_t>(path));
        hash = mix(hash, static_cast<std::uint32_t>(path >> 32));
        hash = mix(mix(hash, triangle), 0xC2B2AE3DU);
        return static_cast<float>((hash >> 8) + 1) * 0x1p-24F;
    }

    [[nodiscard]] RAYNEST_FN float least_alpha(const MaterialRecord& material, const Ray& ray,
                                               std::uint64_t path, std::uint32_t triangle) const {
        return material.alpha_mode == AlphaMode::blend ? threshold(ray, path, triangle)
               : cutoff >= 0                           ? cutoff
                                                       : material.cutoff;
    }

    [[nodiscard]] RAYNEST_NOINLINE bool is_solid(const ObjectRecord& object, const Surface& surface,
                                                 const TriangleBlock* block, const Ray& ray,
                                                 std::uint64_t path) const {
        return has_alpha_of(scene, object, surface, block,
                            [&](const MaterialRecord& material) RAYNEST_INLINE_LAMBDA {
                                return least_alpha(material, ray, path, surface.prim);
                            });
    }

    const SceneView& scene;
    float cutoff;
    std::uint32_t seed;
};

}  // namespace raynest
