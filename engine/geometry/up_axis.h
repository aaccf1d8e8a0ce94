// Which axis of a scene points up. Coordinates stay as they are; cameras that are chosen for the
// user, the sky, its sun and pictures of the surroundings follow it.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

enum class UpAxis : std::uint8_t {
    y,  ///< as in glTF: east is +X, north is -Z
    z   ///< as on a map: east is +X, north is +Y
};

/// The axis as a unit vector.
[[nodiscard]] inline glm::dvec3 upwards(UpAxis up) {
    return up == UpAxis::z ? glm::dvec3(0, 0, 1) : glm::dvec3(0, 1, 0);
}

/// Turns a vector of a scene to where it is with +Y up: up stays up, and north stays north. Exact, and
/// without -0.
template <class Vector>
[[nodiscard]] Vector to_y_up(UpAxis up, const Vector& v) {
    return up == UpAxis::z ? Vector(v.x, v.z, 0 - v.y) : v;
}

/// The inverse of to_y_up().
template <class Vector>
[[nodiscard]] Vector from_y_up(UpAxis up, const Vector& v) {
    return up == UpAxis::z ? Vector(v.x, 0 - v.z, v.y) : v;
}

/// The map from coordinates of a scene with one axis up to those of one with another.
[[nodiscard]] inline glm::dmat4 turn_of(UpAxis from, UpAxis to) {
    glm::dmat4 made(1);
    for (int i = 0; i < 3; ++i)
        made[i] = glm::dvec4(from_y_up(to, to_y_up(from, glm::dvec3(made[i]))), 0);
    return made;
}

}  // namespace raynest
