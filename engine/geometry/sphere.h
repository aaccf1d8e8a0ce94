// A sphere: two hits, so that refusing the entry leaves the exit.
#pragma once

#include "engine/geometry/record.h"
#include "engine/geometry/sphere_shape.h"

#include <cmath>

namespace raynest {

/// The discriminant is taken at the ray's closest approach to the centre, which keeps its digits
/// for far and small spheres (Haines, Guenther, Akenine-Moeller, "Precision improvements for
/// ray/sphere intersection", Ray Tracing Gems, 2019), in float64: 1.8 m above a sphere of the
/// Earth's size float32 would be off by metres. The hit nearer to the origin comes from the product
/// of both, so that it loses no digits either, and float32 is enough for the root. u and v are 0.
template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Sphere& sphere) {
    struct Wide {
        double x, y, z;
    };
    const auto dot = [](const Wide& a, const Wide& b) { return a.x * b.x + a.y * b.y + a.z * b.z; };
    auto hits = no_hits<2>(sphere);
    const Wide d{ray.direction.x, ray.direction.y, ray.direction.z};
    const Wide to_center{double{sphere.center.x} - double{ray.origin.x},
                         double{sphere.center.y} - double{ray.origin.y},
                         double{sphere.center.z} - double{ray.origin.z}};
    const double a = dot(d, d);
    const auto rounded = static_cast<float>(a);
    if (!(rounded > 0)) return hits;  // a direction so short that its square vanishes
    // Two steps of Newton's method: a division in float64 makes kernels for GPUs spill.
    double inverse = 1.0F / rounded;
    inverse *= 2 - a * inverse;
    inverse *= 2 - a * inverse;
    const double nearest = dot(to_center, d) * inverse;
    const Wide off{to_center.x - nearest * d.x, to_center.y - nearest * d.y,
                   to_center.z - nearest * d.z};
    const double radius = sphere.radius;
    const double room = radius * radius - dot(off, off);
    if (!(room >= 0)) return hits;
    const auto middle = static_cast<float>(nearest);
    const float half = std::sqrt(static_cast<float>(room * inverse));
    const float farther = middle + std::copysign(half, middle);
    const double product = (dot(to_center, to_center) - radius * radius) * inverse;
    const float nearer = static_cast<float>(product) / farther;
    const bool ahead = middle >= 0;
    add_hit(hits, 0, ahead ? nearer : farther, 0, 0, true);
    add_hit(hits, 1, ahead ? farther : nearer, 0, 0, false);
    return hits;
}

}  // namespace raynest
