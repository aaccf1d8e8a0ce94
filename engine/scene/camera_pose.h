// A camera's pose is the transform of its node without scale.
#pragma once

#include "engine/math/vec.h"

#include <array>
#include <optional>

namespace raynest {

/// Of axes and a place.
[[nodiscard]] Transform pose_of(const glm::dvec3& x, const glm::dvec3& y, const glm::dvec3& z,
                                const glm::dvec3& place);

/// -Z and +Y keep their directions as far as they agree, +X follows. Rows of 4, as in a Transform;
/// in double, so that a large scale goes before it is rounded. Nothing where there is no direction
/// or the place is not a finite float.
[[nodiscard]] std::optional<Transform> camera_pose(const std::array<double, 12>& to_world);

}  // namespace raynest
