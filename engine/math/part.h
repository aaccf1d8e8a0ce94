// The part of lanes without SIMD: one float. math/highway_part.h has the same operations on a
// register.
#pragma once

#include "engine/math/vec.h"

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace raynest::part {

/// The type of the parts of N lanes.
template <int N>
struct PartOf {
    using type = float;
};
/// Number of lanes in one part.
template <class Part>
inline constexpr std::size_t width = 1;

RAYNEST_INLINE void set(float& to, float value) {
    to = value;
}
RAYNEST_INLINE void load(float& to, const float* from) {
    to = *from;
}
RAYNEST_INLINE void store(float a, float* to) {
    *to = a;
}
RAYNEST_INLINE void load_records(float (&to)[8], const float* from) {
    for (int k = 0; k < 8; ++k) to[k] = from[k];
}
RAYNEST_INLINE float add(float a, float b) {
    return a + b;
}
RAYNEST_INLINE float subtract(float a, float b) {
    return a - b;
}
RAYNEST_INLINE float multiply(float a, float b) {
    return a * b;
}
RAYNEST_INLINE float divide(float a, float b) {
    return a / b;
}
RAYNEST_INLINE float minimum(float a, float b) {
    return a < b ? a : b;
}
RAYNEST_INLINE float maximum(float a, float b) {
    return a > b ? a : b;
}
RAYNEST_INLINE float flip_sign(float a, float b) {
    return std::signbit(b) ? -a : a;
}
RAYNEST_INLINE float select(std::uint32_t mask, float a, float b) {
    return (mask & 1U) != 0 ? a : b;
}
RAYNEST_INLINE float least(float a) {
    return a;
}
RAYNEST_INLINE float most(float a) {
    return a;
}
RAYNEST_INLINE float fused(float a, float b, float c) {
    return raynest::fused(a, b, c);
}
RAYNEST_INLINE std::uint32_t negative(float a) {
    return std::bit_cast<std::uint32_t>(a) >> 31;
}
RAYNEST_INLINE std::uint32_t less(float a, float b) {
    return a < b ? 1 : 0;
}
RAYNEST_INLINE std::uint32_t less_equal(float a, float b) {
    return a <= b ? 1 : 0;
}

}  // namespace raynest::part
