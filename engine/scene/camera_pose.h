// The pose of a camera or a light is the transform of its node without scale.
#pragma once

#include "engine/math/vec.h"

#include <array>
#include <optional>

namespace raynest {

/// Returns the transform with these axes and this position.
[[nodiscard]] Transform pose_of(const glm::dvec3& x, const glm::dvec3& y, const glm::dvec3& z,
                                const glm::dvec3& place);

/// Removes the scale of a transform: -Z keeps its direction, +Y keeps it as far as it can, +X
/// follows. Rows of 4, as in a Transform, in double, so that a large scale is removed before
/// rounding. Nothing if a direction is missing or the position is not finite in float32.
[[nodiscard]] std::optional<Transform> camera_pose(const std::array<double, 12>& to_world);

/// Where a pose stands.
[[nodiscard]] inline Vec3 place_of(const Transform& pose) {
    return {pose.m[3], pose.m[7], pose.m[11]};
}
/// Where a pose looks, or shines, to: its -Z, a unit vector.
[[nodiscard]] inline Vec3 ahead_of(const Transform& pose) {
    return -glm::normalize(Vec3(pose.m[2], pose.m[6], pose.m[10]));
}

}  // namespace raynest
