// Permuting and packing eight lanes: what a traversal without branches sorts its children with.
#pragma once

#include "engine/math/lanes.h"

#include <bit>
#include <cstdint>

namespace raynest {

/// Packs those lanes of `values` and `words` that `mask` names, taken in the order of `lanes`
/// (three low bits of each: a lane number), to the front of `to_values` and `to_words`. All eight
/// places of both are written, to any address. Returns how many lanes were packed.
template <int N>
RAYNEST_INLINE std::uint32_t pack_ordered(const Lanes<N>& values, const std::uint32_t* words,
                                          std::uint32_t mask, const std::uint32_t* lanes,
                                          std::uint32_t shift, float* to_values,
                                          std::uint32_t* to_words) {
    namespace hn = part::hn;
    const hn::CappedTag<float, 8> f32;
    const hn::RebindToUnsigned<decltype(f32)> u32;
    static_assert(N == 8 && Lanes<N>::parts == 1, "needs registers of eight lanes: v3 and up");

    // Lanes that are not named become infinite, so that the mask travels with its values.
    const auto infinity = hn::Set(f32, std::numeric_limits<float>::infinity());
    const std::uint8_t bits[8] = {static_cast<std::uint8_t>(mask)};
    const auto kept = hn::IfThenElse(hn::LoadMaskBits(f32, bits), values.lane[0], infinity);
    const auto slots =
        hn::And(hn::ShiftRightSame(hn::Load(u32, lanes), static_cast<int>(shift)), hn::Set(u32, 7));
    const auto order =
        hn::IndicesFromVec(f32, hn::BitCast(hn::RebindToSigned<decltype(f32)>(), slots));
    const auto sorted = hn::TableLookupLanes(kept, order);
    const auto child =
        hn::BitCast(u32, hn::TableLookupLanes(hn::BitCast(f32, hn::Load(u32, words)), order));
    const auto named = sorted < infinity;
    // Into a register, then stored: compressing to memory is microcode on some CPUs.
    hn::StoreU(hn::Compress(sorted, named), f32, to_values);
    hn::StoreU(hn::Compress(child, hn::RebindMask(u32, named)), u32, to_words);
    return static_cast<std::uint32_t>(std::popcount(mask));
}

}  // namespace raynest
