// A parameter with many values: the curve of a filter, a list of ids.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

/// The values that a request brings for one parameter, in its order; none where it brings none.
/// They last as long as the call.
struct Table {
    const float* values = nullptr;
    std::uint32_t count = 0;

    [[nodiscard]] RAYNEST_FN float operator[](std::uint32_t i) const { return values[i]; }
    [[nodiscard]] RAYNEST_FN const float* begin() const { return values; }
    [[nodiscard]] RAYNEST_FN const float* end() const { return values + count; }
};

}  // namespace raynest
