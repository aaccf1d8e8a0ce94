// An axis-aligned box. Boxes only cull: they never decide a hit.
#pragma once

#include "engine/math/vec.h"

#include <limits>

namespace raynest {

/// Default-constructed it is empty: it contains nothing and extending it by a point gives the
/// point.
struct Box {
    using box_tag = void;  ///< BoxLike (geometry/concepts.h)
    Vec3 lower{std::numeric_limits<float>::infinity()};
    Vec3 upper{-std::numeric_limits<float>::infinity()};

    RAYNEST_FN void extend(const Vec3& p) {
        lower = glm::min(lower, p);
        upper = glm::max(upper, p);
    }
    RAYNEST_FN void extend(const Box& b) {
        lower = glm::min(lower, b.lower);
        upper = glm::max(upper, b.upper);
    }
    [[nodiscard]] bool is_empty() const { return !(lower.x <= upper.x); }
    [[nodiscard]] Vec3 size() const { return upper - lower; }
    [[nodiscard]] float half_area() const {
        if (is_empty()) return 0;
        const Vec3 s = size();
        return s.x * s.y + s.y * s.z + s.z * s.x;
    }
};
static_assert(sizeof(Box) == 24);

}  // namespace raynest
