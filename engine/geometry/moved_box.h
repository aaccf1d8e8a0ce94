// The box around a box that a transform moves.
#pragma once

#include "engine/geometry/box.h"
#include "engine/math/vec.h"

namespace raynest {

/// Returns the smallest box around the eight moved corners; empty for an empty box.
[[nodiscard]] inline Box moved_box(const Box& box, const Transform& transform) {
    Box moved;
    if (box.is_empty()) return moved;
    for (unsigned corner = 0; corner < 8; ++corner)
        moved.extend(transform.point({(corner & 1U) != 0 ? box.upper.x : box.lower.x,
                                      (corner & 2U) != 0 ? box.upper.y : box.lower.y,
                                      (corner & 4U) != 0 ? box.upper.z : box.lower.z}));
    return moved;
}

}  // namespace raynest
