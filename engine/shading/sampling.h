// Directions and points from pairs of random numbers, and frames around a normal.
#pragma once

#include "engine/math/elementary.h"
#include "engine/math/vec.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace raynest {

inline constexpr float pi = std::numbers::pi_v<float>;
inline constexpr float one_below = 0x1.fffffep-1F;  ///< the largest float below 1

/// Three perpendicular unit vectors; z is the normal.
struct Basis {
    Vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};

    [[nodiscard]] Vec3 to_world(const Vec3& v) const { return v.x * x + v.y * y + v.z * z; }
    [[nodiscard]] Vec3 to_local(const Vec3& v) const {
        return {glm::dot(v, x), glm::dot(v, y), glm::dot(v, z)};
    }
};

/// A basis whose z is a unit vector, without a branch for any direction (Duff et al., "Building an
/// Orthonormal Basis, Revisited", JCGT 2017).
inline Basis basis_around(const Vec3& n) {
    const float sign = std::copysign(1.0F, n.z);
    const float a = -1.0F / (sign + n.z);
    const float b = n.x * n.y * a;
    return {
        {1.0F + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}, n};
}

/// Y of linear Rec. 709.
inline float brightness(const Vec3& rgb) {
    return 0.2126F * rgb.x + 0.7152F * rgb.y + 0.0722F * rgb.z;
}

inline bool is_black(const Vec3& rgb) {
    return !(rgb.x > 0 || rgb.y > 0 || rgb.z > 0);
}

inline float largest(const Vec3& rgb) {
    return std::max({rgb.x, rgb.y, rgb.z});
}

/// A direction on the hemisphere around +z with density cos / pi.
inline Vec3 sample_cosine(const Vec2& u) {
    const float radius = std::sqrt(u.x);
    const Vec2 around = radius * circle(u.y);
    return {around.x, around.y, std::sqrt(std::max(0.0F, 1.0F - u.x))};
}

/// Barycentric coordinates (u, v) of a point that is uniform on a triangle.
inline Vec2 sample_triangle(const Vec2& u) {
    const float root = std::sqrt(u.x);
    return {1.0F - root, u.y * root};
}

/// A unit vector from the azimuth around +y and the elevation above the horizon, both in radians:
/// azimuth 0 is -z, and a quarter turn is +x.
inline Vec3 from_azimuth(float azimuth, float elevation) {
    const float across = std::cos(elevation);
    return {across * std::sin(azimuth), std::sin(elevation), -across * std::cos(azimuth)};
}

/// The weight of a sample of one strategy beside one of another (Veach's power heuristic).
inline float power_heuristic(float density, float other) {
    if (density <= 0) return 0;
    const float ratio = other / density;
    return 1.0F / (1.0F + ratio * ratio);
}

}  // namespace raynest
