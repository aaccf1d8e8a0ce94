// The 32 bytes of a ray, which the wire, the pack ABI and the file formats share.
#pragma once

#include "engine/math/finite.h"

#include <cmath>
#include <limits>

namespace raynest {

/// Hits lie in (tmin, tmax], in units of the direction's length; directions are never normalised.
struct Ray {
    Vec3 origin{0.0F};
    float tmin = 0.0F;
    Vec3 direction{0.0F};
    float tmax = std::numeric_limits<float>::infinity();
};
static_assert(sizeof(Ray) == 32);

/// True if 0 <= tmin <= tmax, the direction is not zero, and all numbers are finite, except that
/// tmax may be +inf. An invalid ray gives the canonical miss and flag 1.
[[nodiscard]] RAYNEST_FN inline bool is_valid(const Ray& r) {
    const bool directed = r.direction.x != 0 || r.direction.y != 0 || r.direction.z != 0;
    return is_finite(r.origin) && is_finite(r.direction) && directed && std::isfinite(r.tmin) &&
           r.tmin >= 0 && r.tmin <= r.tmax;
}

}  // namespace raynest
