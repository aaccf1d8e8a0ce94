// Permutes and packs eight lanes, to sort a node's children without branches.
#pragma once

#include "engine/math/lanes.h"

#include <array>
#include <bit>
#include <cstdint>

namespace raynest {

namespace part {

/// For each mask of eight lanes: the numbers of its lanes in ascending order, 4 bits each.
inline constexpr auto packed_lanes = [] {
    std::array<std::uint32_t, 256> table{};
    for (std::uint32_t mask = 0; mask < 256; ++mask) {
        std::uint32_t to = 0;
        for (std::uint32_t lane = 0; lane < 8; ++lane) {
            if ((mask >> lane & 1U) != 0) table[mask] |= lane << (4 * to++);
        }
    }
    return table;
}();

/// Moves the lanes of `mask` to the front of a register; compressing to memory is microcode on some
/// CPUs. Without an instruction for it, Highway's Compress is avoided: GCC copies its table of 1
/// KiB to the stack for every call, which took 60 % of a stream on AVX2.
#if HWY_TARGET <= HWY_AVX3
template <class D>
RAYNEST_INLINE hn::Vec<D> pack_lanes(D, hn::Vec<D> v, hn::Mask<D> mask) {
    return hn::Compress(v, mask);
}
template <class D>
RAYNEST_INLINE hn::Vec<D> pack_lanes(D d, hn::Vec<D> v, std::uint32_t mask) {
    const std::uint8_t bits[8] = {static_cast<std::uint8_t>(mask)};
    return pack_lanes(d, v, hn::LoadMaskBits(d, bits));
}
#else
template <class D>
RAYNEST_INLINE hn::Vec<D> pack_lanes(D d, hn::Vec<D> v, std::uint32_t mask) {
    const hn::RebindToUnsigned<D> u32;
    const auto shift = hn::ShiftLeft<2>(hn::Iota(u32, 0));
    const auto lanes = hn::And(hn::Set(u32, packed_lanes[mask]) >> shift, hn::Set(u32, 7));
    return hn::TableLookupLanes(v,
                                hn::IndicesFromVec(d, hn::BitCast(hn::RebindToSigned<D>(), lanes)));
}
template <class D>
RAYNEST_INLINE hn::Vec<D> pack_lanes(D d, hn::Vec<D> v, hn::Mask<D> mask) {
    std::uint8_t bits[8];
    hn::StoreMaskBits(d, mask, bits);
    return pack_lanes(d, v, std::uint32_t{bits[0]});
}
#endif

}  // namespace part

/// Packs the lanes of `values` and `words` that are in `mask`, in the order of `lanes` (lane
/// numbers: three low bits of each, after a shift down by `shift`), to the front of `to_values` and
/// `to_words`. Writes all eight entries of both, to any address. Returns the number packed.
RAYNEST_INLINE std::uint32_t pack_ordered(const Lanes<8>& values, const std::uint32_t* words,
                                          std::uint32_t mask, const std::uint32_t* lanes,
                                          std::uint32_t shift, float* to_values,
                                          std::uint32_t* to_words) {
    if constexpr (Lanes<8>::parts == 1) {
        namespace hn = part::hn;
        const hn::CappedTag<float, 8> f32;
        const hn::RebindToUnsigned<decltype(f32)> u32;
        // Lanes outside the mask become infinite, so that the values carry the mask.
        const auto infinity = hn::Set(f32, std::numeric_limits<float>::infinity());
        const std::uint8_t bits[8] = {static_cast<std::uint8_t>(mask)};
        const auto kept = hn::IfThenElse(hn::LoadMaskBits(f32, bits), values.lane[0], infinity);
        const auto slots = hn::And(
            hn::ShiftRightSame(hn::Load(u32, lanes), static_cast<int>(shift)), hn::Set(u32, 7));
        const auto order =
            hn::IndicesFromVec(f32, hn::BitCast(hn::RebindToSigned<decltype(f32)>(), slots));
        const auto sorted = hn::TableLookupLanes(kept, order);
        const auto child =
            hn::BitCast(u32, hn::TableLookupLanes(hn::BitCast(f32, hn::Load(u32, words)), order));
        const auto named = sorted < infinity;
        hn::StoreU(part::pack_lanes(f32, sorted, named), f32, to_values);
        hn::StoreU(part::pack_lanes(u32, child, hn::RebindMask(u32, named)), u32, to_words);
    } else {
        alignas(32) float from[8];
        values.store(from);
        for (std::uint32_t i = 0, to = 0; i < 8; ++i) {
            const std::uint32_t lane = lanes[i] >> shift & 7U;
            to_values[to] = from[lane];
            to_words[to] = words[lane];
            to += mask >> lane & 1U;
        }
    }
    return static_cast<std::uint32_t>(std::popcount(mask));
}

/// Does the same for lanes whose `values` are at most `limits`, of those that `lanes` names first,
/// a bit each in `first`. A mask would have to be made first, and put in order.
RAYNEST_INLINE std::uint32_t pack_ordered(const Lanes<8>& values, const Lanes<8>& limits,
                                          const std::uint32_t* words, std::uint32_t first,
                                          const std::uint32_t* lanes, std::uint32_t shift,
                                          float* to_values, std::uint32_t* to_words) {
    if constexpr (Lanes<8>::parts == 1) {
        namespace hn = part::hn;
        const hn::CappedTag<float, 8> f32;
        const hn::RebindToUnsigned<decltype(f32)> u32;
        const auto slots = hn::And(
            hn::ShiftRightSame(hn::Load(u32, lanes), static_cast<int>(shift)), hn::Set(u32, 7));
        const auto order =
            hn::IndicesFromVec(f32, hn::BitCast(hn::RebindToSigned<decltype(f32)>(), slots));
        const auto sorted = hn::TableLookupLanes(values.lane[0], order);
        const auto limit = hn::TableLookupLanes(limits.lane[0], order);
        const auto child =
            hn::BitCast(u32, hn::TableLookupLanes(hn::BitCast(f32, hn::Load(u32, words)), order));
#if HWY_TARGET <= HWY_AVX3
        const std::uint8_t bits[8] = {static_cast<std::uint8_t>(first)};
        const auto named = hn::And(sorted <= limit, hn::LoadMaskBits(f32, bits));
        const std::uint32_t mask = part::bits<hn::Vec<decltype(f32)>>(named);
        hn::StoreU(part::pack_lanes(f32, sorted, named), f32, to_values);
        hn::StoreU(part::pack_lanes(u32, child, hn::RebindMask(u32, named)), u32, to_words);
#else
        const std::uint32_t mask = part::less_equal(sorted, limit) & first;
        hn::StoreU(part::pack_lanes(f32, sorted, mask), f32, to_values);
        hn::StoreU(part::pack_lanes(u32, child, mask), u32, to_words);
#endif
        return static_cast<std::uint32_t>(std::popcount(mask));
    } else {
        return pack_ordered(values, words, less_equal(values, limits) & first, lanes, shift,
                            to_values, to_words);
    }
}

/// Packs the words of eight that are in `mask` to the front of `to`. Writes all eight entries of
/// `to`. Returns the number packed.
RAYNEST_INLINE std::uint32_t pack_words(const std::uint32_t* words, std::uint32_t mask,
                                        std::uint32_t* to) {
    if constexpr (Lanes<8>::parts == 1) {
        namespace hn = part::hn;
        const hn::CappedTag<std::uint32_t, 8> u32;
        hn::StoreU(part::pack_lanes(u32, hn::Load(u32, words), mask), u32, to);
    } else {
        for (std::uint32_t lane = 0, at = 0; lane < 8; ++lane) {
            to[at] = words[lane];
            at += mask >> lane & 1U;
        }
    }
    return static_cast<std::uint32_t>(std::popcount(mask));
}

}  // namespace raynest
