// How finely float32 tells numbers apart.
#pragma once

#include <cmath>
#include <limits>

namespace raynest {

/// Returns the distance from a finite number to the next one away from zero.
inline double float_step(float number) {
    const float at = std::abs(number);
    return double{std::nextafter(at, std::numeric_limits<float>::infinity())} - double{at};
}

}  // namespace raynest
