// Whether all numbers of a point or a map are finite.
#pragma once

#include "engine/math/vec.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace raynest {

[[nodiscard]] RAYNEST_FN inline bool is_finite(const Vec3& v) {
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

template <class Number, std::size_t Count>
[[nodiscard]] bool is_finite(const std::array<Number, Count>& numbers) {
    return std::all_of(numbers.begin(), numbers.end(), [](Number x) { return std::isfinite(x); });
}

}  // namespace raynest
