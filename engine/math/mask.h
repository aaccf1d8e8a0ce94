// Masks: plain bits, one per lane, child or ray.
#pragma once

#include "engine/math/vec.h"

#include <bit>
#include <concepts>
#include <cstdint>

namespace raynest {

/// Returns the place of the lowest bit that is set. Of an empty mask: its width on the CPU,
/// unspecified on a GPU. Not std::countr_zero: nvcc 13.0 compiles libstdc++'s to the constant 32,
/// without a warning, and a ray then reads a child that no node has.
template <std::unsigned_integral Mask>
[[nodiscard]] RAYNEST_INLINE std::uint32_t lowest_bit(Mask mask) {
#ifdef __CUDA_ARCH__
    static_assert(sizeof(Mask) == sizeof(int));
    return static_cast<std::uint32_t>(__ffs(static_cast<int>(mask)) - 1);
#else
    return static_cast<std::uint32_t>(std::countr_zero(mask));
#endif
}

}  // namespace raynest
