#include "engine/scene/camera_pose.h"

#include <cmath>

namespace raynest {

Transform pose_of(const glm::dvec3& x, const glm::dvec3& y, const glm::dvec3& z,
                  const glm::dvec3& place) {
    Transform pose;
    for (int row = 0; row < 3; ++row) {
        const auto at = 4 * static_cast<std::size_t>(row);
        pose.m[at] = static_cast<float>(x[row]);
        pose.m[at + 1] = static_cast<float>(y[row]);
        pose.m[at + 2] = static_cast<float>(z[row]);
        pose.m[at + 3] = static_cast<float>(place[row]);
    }
    return pose;
}

std::optional<Transform> camera_pose(const std::array<double, 12>& to_world) {
    const auto column = [&](std::size_t c) {
        return glm::dvec3(to_world[c], to_world[4 + c], to_world[8 + c]);
    };
    const glm::dvec3 backward = column(2);
    const glm::dvec3 z = glm::normalize(backward);
    const glm::dvec3 upward = column(1) - z * glm::dot(z, column(1));
    const glm::dvec3 y = glm::normalize(upward);
    const glm::dvec3 x = glm::cross(y, z);
    // An overflow would normalise to zero.
    if (!std::isfinite(glm::dot(backward, backward) + glm::dot(upward, upward)) ||
        !std::isfinite(glm::dot(x + y + z, glm::dvec3(1)))) {
        return std::nullopt;
    }
    const Transform pose = pose_of(x, y, z, column(3));
    const bool placed =
        std::isfinite(pose.m[3]) && std::isfinite(pose.m[7]) && std::isfinite(pose.m[11]);
    return placed ? std::optional(pose) : std::nullopt;
}

}  // namespace raynest
