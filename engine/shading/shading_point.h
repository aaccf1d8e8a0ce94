// A hit as a material sees it: the frame of its shading normal, and the values of its textures
// there.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/shading/material.h"
#include "engine/shading/placement.h"
#include "engine/shading/records.h"
#include "engine/shading/sampling.h"
#include "engine/shading/texture_batch.h"

#include <array>
#include <cstdint>

namespace raynest {

struct ShadingPoint {
    Basis frame;             ///< z: the shading normal, on the side that the ray came from
    Vec3 normal{0};          ///< geometric, on the same side
    bool front = true;       ///< the ray met the outer side
    std::uint32_t kind = 0;  ///< SurfaceRecord::kind
    const SurfaceRecord* surface = nullptr;
    MaterialPoint material;
    Vec3 smooth{0};  ///< the vertices' normal, on the side that the ray came from
    /// From the hit to the smooth surface that the vertices' normals suggest; 0 on flat and hollow
    /// ones.
    Vec3 to_smooth{0};

    /// True if light may be scattered to or from a direction: it must lie on one side of the
    /// surface and of the shading normal. On a bulge the smooth surface decides, not the flat
    /// triangle, so that shadows have no facets.
    [[nodiscard]] bool scatters(const Vec3& world, const Vec3& local) const {
        if ((glm::dot(world, normal) > 0) == (local.z > 0)) return true;
        return local.z > 0 && to_smooth != Vec3(0) && glm::dot(world, smooth) > 0;
    }
    /// The way from the hit to where such a direction starts: to the smooth surface where the
    /// direction grazes the triangle, 0 elsewhere and through the surface.
    [[nodiscard]] Vec3 shift(const Vec3& world, const Vec3& local) const {
        constexpr float grazing = 0.1F;
        if (local.z <= 0) return Vec3(0);
        return std::clamp(1.0F - glm::dot(world, normal) / grazing, 0.0F, 1.0F) * to_smooth;
    }
};

/// A point whose textures are being looked up.
struct UnfinishedPoint {
    ShadingPoint point;
    Vec3 viewer{0};
    Vec3 n{0};        ///< the vertices' normal in the world, outward
    Vec3 tangent{0};  ///< with bitangent and n, the frame of the normal texture
    Vec3 bitangent{0};
    Vec3 tint{1};                                   ///< the vertices' colour
    std::array<Vec4, surface_textures + 1> texels;  ///< by TextureSlot
    std::uint32_t looked_up = 0;                    ///< bit k: texels[k] will be there

    [[nodiscard]] const Vec4* texel(TextureSlot slot) const {
        const auto k = static_cast<std::size_t>(slot);
        return (looked_up >> k & 1U) != 0 ? &texels[k] : nullptr;
    }
};

/// Fetches the corners of a triangle that will be shaded soon; fetch_vertices(), some hits later,
/// what lies at them. Triangles of bounced rays lie anywhere in memory.
void fetch_corners(const SceneView& scene, const HitRecord& hit);
void fetch_vertices(const ShadingView& view, const HitRecord& hit);

/// Adds the lookups of a hit to the batch; `point` stays where it is until the batch has run.
/// `placement` is that of hit.path, `normal` is the hit's geometric normal in the world, outward,
/// `twice_area` belongs to its triangle in the world, and `width` is that of the ray's cone there.
void begin_point(const ShadingView& view, const Ray& ray, const HitRecord& hit, const Vec3& normal,
                 double twice_area, float width, const Placement& placement, TextureBatch& batch,
                 UnfinishedPoint& point);
/// After the batch has run.
[[nodiscard]] const ShadingPoint& finish_point(UnfinishedPoint& point);

/// The radiance that a point of a triangle emits, given by its barycentric coordinates.
[[nodiscard]] Vec3 triangle_emission(const ShadingView& view, const ObjectRecord& object,
                                     std::uint32_t triangle, float u, float v);

}  // namespace raynest
