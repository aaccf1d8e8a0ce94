// What float32 costs a scene: triangles that nothing can hit, and places that moved.
#pragma once

#include "engine/geometry/box.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <string>

namespace raynest {

/// Triangles of which the intersection test sees no area, from no side: their corners lie on one
/// line, or so close together that the test's products vanish.
[[nodiscard]] std::uint64_t count_degenerate(const GeometryDescription& geometry);

/// A warning with the distance by which rounding moved something and with an origin that avoids
/// that; "" where the distance is small beside a scene of these bounds, which are relative to
/// `origin`.
[[nodiscard]] std::string rounding_warning(double rounding, const WorldPoint& origin,
                                           const Box& bounds);

}  // namespace raynest
