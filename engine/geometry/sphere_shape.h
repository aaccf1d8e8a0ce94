// The data of a sphere, without its intersection test: for code that describes scenes.
#pragma once

#include "engine/geometry/box.h"

#include <cmath>

namespace raynest {

struct Sphere {
    Vec3 center;
    float radius;
};

[[nodiscard]] RAYNEST_FN inline Box bounds(const Sphere& sphere) {
    // One part in 2^20 of slack: the quadratic of intersect() rounds.
    const float extent = std::abs(sphere.radius) * 1.000001F;
    return {sphere.center - Vec3(extent), sphere.center + Vec3(extent)};
}

[[nodiscard]] RAYNEST_FN inline Vec3 normal(const Sphere& sphere, const Vec3& point) {
    return point - sphere.center;
}

}  // namespace raynest
