// A hit as a material sees it: the frame of its shading normal, and the values of its textures there.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/shading/material.h"
#include "engine/shading/placement.h"
#include "engine/shading/records.h"
#include "engine/shading/sampling.h"
#include "engine/shading/texture_lookup.h"

#include <cstdint>

namespace raynest {

struct ShadingPoint {
    Frame frame;        ///< z: the shading normal, on the side that the ray came from
    Vec3 normal{0};     ///< geometric, on the same side
    bool front = true;  ///< the ray met the outer side
    std::uint32_t kind = 0;  ///< SurfaceRecord::kind
    const SurfaceRecord* surface = nullptr;
    MaterialPoint material;
    float occlusion = 1;  ///< of the occlusion texture
};

/// Looks all textures up. `placement` is that of hit.path, `normal` is the hit's geometric normal in the world, outward; `width` is
/// that of the ray's cone at the hit.
[[nodiscard]] ShadingPoint shading_point(const ShadingView& view, const Ray& ray,
                                         const HitRecord& hit, const Vec3& normal, float width,
                                         const Placement& placement);

/// The radiance that a point of a triangle emits, given by its barycentric coordinates.
[[nodiscard]] Vec3 triangle_emission(const ShadingView& view, const ObjectRecord& object,
                                     std::uint32_t triangle, float u, float v);

}  // namespace raynest
