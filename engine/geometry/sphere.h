// A sphere: two hits, so that refusing the entry leaves the exit.
#pragma once

#include "engine/geometry/record.h"
#include "engine/geometry/sphere_shape.h"

#include <cmath>

namespace raynest {

/// The discriminant is taken at the ray's closest approach to the centre, which keeps its digits
/// for far and small spheres (Haines, Guenther, Akenine-Moeller, "Precision improvements for
/// ray/sphere intersection", Ray Tracing Gems, 2019). u and v are 0.
template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Sphere& sphere) {
    auto hits = no_hits<2>(sphere);
    const auto dot = [](const Vec3& a, const Vec3& b) {
        return fused(a.x, b.x, fused(a.y, b.y, a.z * b.z));
    };
    const Vec3 d = ray.direction;
    const Vec3 to_center = sphere.center - ray.origin;
    const float a = dot(d, d);
    if (!(a > 0)) return hits;  // a direction so short that its square vanishes
    const float nearest = dot(to_center, d) / a;
    const Vec3 off{fused(-nearest, d.x, to_center.x), fused(-nearest, d.y, to_center.y),
                   fused(-nearest, d.z, to_center.z)};
    const float room = fused(sphere.radius, sphere.radius, -dot(off, off));
    if (!(room >= 0)) return hits;
    const float half = std::sqrt(room / a);
    add_hit(hits, 0, nearest - half, 0, 0, true);
    add_hit(hits, 1, nearest + half, 0, 0, false);
    return hits;
}

}  // namespace raynest
