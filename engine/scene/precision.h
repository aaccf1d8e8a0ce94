// The cost of float32 for a scene: triangles that cannot be hit, and moved vertices.
#pragma once

#include "engine/geometry/box.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <string>

namespace raynest {

/// True if a triangle has no area for the intersection test, whatever the ray's direction: its
/// corners are on one line, or so close together that the test's products vanish.
[[nodiscard]] bool is_degenerate(const Vec3& a, const Vec3& b, const Vec3& c);

/// Counts such triangles.
[[nodiscard]] std::uint64_t count_degenerate(const GeometryDescription& geometry);

/// Returns how far a point of float32 coordinates may be off from what it was rounded from: half a
/// step of each coordinate that uses its last digit. Coordinates of fewer digits are taken for
/// exact.
[[nodiscard]] double half_step(const Vec3& point);

/// Returns a warning with the distance by which rounding moved something, here or before the file
/// was written (SceneDescription), and with a point that avoids that; "" if the distance is small
/// compared with the scene's bounds, which are relative to its origin.
[[nodiscard]] std::string rounding_warning(const SceneDescription& scene, const Box& bounds);

/// Returns a warning if float32 is so coarse where a scene lies that light starts visibly beside
/// the surfaces it leaves, with an origin that avoids that; else "". `bounds` are relative to
/// `origin`.
[[nodiscard]] std::string light_warning(const WorldPoint& origin, const Box& bounds);

}  // namespace raynest
