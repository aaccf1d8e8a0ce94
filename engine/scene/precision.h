// The cost of float32 for a scene: triangles that cannot be hit, and moved vertices.
#pragma once

#include "engine/geometry/box.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <string>

namespace raynest {

/// Counts triangles without area for the intersection test, whatever the ray's direction: their
/// corners are on one line, or so close together that the test's products vanish.
[[nodiscard]] std::uint64_t count_degenerate(const GeometryDescription& geometry);

/// Returns a warning with the distance by which rounding moved something, and with an origin that
/// avoids that; "" if the distance is small compared with the scene's bounds, which are relative to
/// `origin`.
[[nodiscard]] std::string rounding_warning(double rounding, const WorldPoint& origin,
                                           const Box& bounds);

}  // namespace raynest
