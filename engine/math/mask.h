// Masks: 32 plain bits, one per lane, child or ray.
#pragma once

#include "engine/math/vec.h"

#include <bit>
#include <cstdint>

namespace raynest {

/// Returns the place of the lowest bit that is set. Of an empty mask: 32 on the CPU, unspecified on
/// a GPU. Not std::countr_zero: nvcc 13.0 compiles libstdc++'s to the constant 32, without a
/// warning, and a ray then reads a child that no node has.
[[nodiscard]] RAYNEST_INLINE std::uint32_t lowest_bit(std::uint32_t mask) {
#ifdef __CUDA_ARCH__
    return static_cast<std::uint32_t>(__ffs(static_cast<int>(mask)) - 1);
#else
    return static_cast<std::uint32_t>(std::countr_zero(mask));
#endif
}

}  // namespace raynest
