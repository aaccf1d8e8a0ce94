// Compares eight words at once.
#pragma once

#include "engine/math/lanes.h"

#include <cstdint>

namespace raynest {

/// Returns how many of eight words are not `value`. `words` are aligned to 32 bytes.
RAYNEST_INLINE std::uint32_t count_other_words(const std::uint32_t* words, std::uint32_t value) {
    if constexpr (Lanes<8>::parts == 1) {
        namespace hn = part::hn;
        const hn::CappedTag<std::uint32_t, 8> u32;
        const auto other = hn::Load(u32, words) != hn::Set(u32, value);
        return static_cast<std::uint32_t>(hn::CountTrue(u32, other));
    } else {
        std::uint32_t count = 0;
        for (int i = 0; i < 8; ++i) count += words[i] != value ? 1 : 0;
        return count;
    }
}

}  // namespace raynest
