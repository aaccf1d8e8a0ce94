// How fast the parts of a scene move.
#pragma once

#include "engine/scene/edits/pose.h"

#include <cstdint>
#include <functional>

namespace raynest {

/// Returns the speed, in the scene's units per second, that nothing exceeds between two moments of
/// an animation that it has: that of the corners of what moves, found from key to key and several
/// times between. What jumps, between the keys of a STEP channel, has no speed. Infinite where it
/// overflows. Looks at each vertex that moves, and at each node for each key; asks `stop` often,
/// and returns 0 once that is true. Thread-safe. Throws std::bad_alloc.
[[nodiscard]] double fastest_speed(const Snapshot& scene, std::uint32_t animation, double from,
                                   double to, const std::function<bool()>& stop);

}  // namespace raynest
