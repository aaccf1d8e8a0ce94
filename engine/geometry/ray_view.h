// The ray as kernels and intersectors see it while it travels through the levels of a scene.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/ray.h"
#include "engine/geometry/views.h"
#include "engine/math/lanes.h"

#include <cstdint>
#include <limits>

namespace raynest {

/// One ray at one level. Inside an instance, origin and direction are in the instance's own space;
/// `t` means the same everywhere, because directions are not renormalised. `tmax` is the best
/// distance so far: it shrinks, and is carried into instances and across roots.
struct RayView {
    static constexpr int lanes = 1;

    Vec3 origin;
    Vec3 direction;
    float tmin;
    float tmax;
    const Ray* world;            ///< as the request gave it
    const SceneView* scene;      ///< null when tracing a plain list
    const ObjectRecord* object;  ///< the level's object; null outside any
    std::uint64_t path;          ///< leaf placements before this level (geometry/path.h)
    std::uint32_t id;            ///< index of the ray in its chunk: where its outputs are kept
    std::uint32_t mask;          ///< instances with (mask & theirs) == 0 are skipped
    std::uint32_t flags;         ///< TraceFlags
    std::uint32_t level = 0;     ///< instances around it: 0 in the root's tree

    /// A point on the ray in this level's space; `world_at` in the space of the request.
    [[nodiscard]] RAYNEST_FN Vec3 at(float t) const { return point_along(origin, direction, t); }
    [[nodiscard]] RAYNEST_FN Vec3 world_at(float t) const {
        return point_along(world->origin, world->direction, t);
    }
};

/// A hit at infinity is no hit, so the search ends at the largest finite distance.
[[nodiscard]] RAYNEST_FN inline float search_end(const Ray& ray) {
    constexpr float farthest = std::numeric_limits<float>::max();
    return ray.tmax < farthest ? ray.tmax : farthest;
}

/// The view of a request's ray at the outermost level.
[[nodiscard]] RAYNEST_FN inline RayView outermost_view(const Ray& ray, const SceneView* scene,
                                                       std::uint32_t id, std::uint32_t mask,
                                                       std::uint32_t flags) {
    return {ray.origin, ray.direction, ray.tmin, search_end(ray), &ray, scene, nullptr, 0,
            id,         mask,          flags};
}

}  // namespace raynest
