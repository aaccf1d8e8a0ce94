// The part of lanes on a CPU: a Highway vector for the target that the pack is compiled for (static
// mode: -march decides).
#pragma once

#ifndef HWY_DISABLE_PCLMUL_AES
#error "define HWY_DISABLE_PCLMUL_AES: without it -march=x86-64-v2..v4 selects SSSE3 in Highway"
#endif
#ifndef HWY_COMPILE_ONLY_STATIC
#define HWY_COMPILE_ONLY_STATIC
#endif

#include "engine/math/part.h"

#include <hwy/highway.h>

#include <bit>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest::part {

namespace hn = hwy::HWY_NAMESPACE;
template <class Vector>
using Tag = hn::DFromV<Vector>;

template <int N>
requires(N == 4 || N == 8 || N == 16) struct PartOf<N> {
    using type = hn::Vec<hn::CappedTag<float, static_cast<std::size_t>(N)>>;
};
template <class Part>
requires(!std::is_same_v<Part, float>) inline constexpr std::size_t width<Part> =
    hn::MaxLanes(Tag<Part>());

template <class Vector>
RAYNEST_INLINE void set(Vector& to, float value) {
    to = hn::Set(Tag<Vector>(), value);
}
/// Returns x, y, z and 1, from registers: through memory the vector would wait for three stores.
template <class Vector>
RAYNEST_INLINE Vector of(const Vec3& v) {
    using Four [[gnu::vector_size(16)]] = float;
    const Four four = {v.x, v.y, v.z, 1.0F};
    return Vector{std::bit_cast<decltype(Vector::raw)>(four)};
}
template <class Vector>
RAYNEST_INLINE void load(Vector& to, const float* from) {
    to = hn::Load(Tag<Vector>(), from);
}
/// Loads four columns of three floats each into x, y and z; the fourth lane is undefined.
template <class Vector>
RAYNEST_INLINE void load_columns(Vector (&to)[4], const float* from) {
    for (int k = 0; k < 3; ++k) to[k] = hn::LoadU(Tag<Vector>(), from + 3 * k);
    to[3] = Shuffle0321(hn::LoadU(Tag<Vector>(), from + 8));  // reads no float after the last
}
/// For each axis: the lanes of turned_to().
alignas(16) inline constexpr std::int32_t turned_lanes[3][4] = {
    {1, 2, 0, 3}, {2, 0, 1, 3}, {0, 1, 2, 3}};
/// Returns the lanes after `axis`, then that of `axis`.
template <class Vector>
RAYNEST_INLINE Vector turned_to(Vector a, std::uint32_t axis) {
    return hn::TableLookupLanes(a, hn::SetTableIndices(Tag<Vector>(), turned_lanes[axis]));
}
/// Returns lanes x, y and z.
template <class Vector>
RAYNEST_INLINE Vec3 to_vec3(Vector a) {
    using Four [[gnu::vector_size(16)]] = float;
    const auto four = std::bit_cast<Four>(a.raw);
    return {four[0], four[1], four[2]};
}
template <class Vector>
RAYNEST_INLINE void store(Vector a, float* to) {
    hn::Store(a, Tag<Vector>(), to);
}
/// Transposes records of eight floats, one per lane: lane i of vector k is float k of record i.
template <class Vector>
RAYNEST_INLINE void load_records(Vector (&to)[8], const float* from) {
    const Tag<Vector> floats;
    const hn::Repartition<std::uint64_t, Tag<Vector>> pairs;
    using Pairs = hn::Vec<hn::Repartition<std::uint64_t, Tag<Vector>>>;
    const auto* pair = reinterpret_cast<const std::uint64_t*>(from);
    Pairs lower[4], upper[4];  // first and second half of the records
    hn::LoadInterleaved4(pairs, pair, lower[0], lower[1], lower[2], lower[3]);
    hn::LoadInterleaved4(pairs, pair + 2 * width<Vector>, upper[0], upper[1], upper[2], upper[3]);
    for (int i = 0; i < 4; ++i) {
        const Vector a = hn::BitCast(floats, lower[i]);
        const Vector b = hn::BitCast(floats, upper[i]);
        // Call by argument-dependent lookup: Highway for plain x86-64, which compiles but never
        // uses this, has no such functions.
        to[2 * i] = ConcatEven(floats, b, a);
        to[2 * i + 1] = ConcatOdd(floats, b, a);
    }
}
template <class Vector>
RAYNEST_INLINE Vector add(Vector a, Vector b) {
    return a + b;
}
template <class Vector>
RAYNEST_INLINE Vector subtract(Vector a, Vector b) {
    return a - b;
}
template <class Vector>
RAYNEST_INLINE Vector multiply(Vector a, Vector b) {
    return a * b;
}
template <class Vector>
RAYNEST_INLINE Vector divide(Vector a, Vector b) {
    return a / b;
}
template <class Vector>
RAYNEST_INLINE Vector minimum(Vector a, Vector b) {
    return hn::Min(a, b);
}
template <class Vector>
RAYNEST_INLINE Vector maximum(Vector a, Vector b) {
    return hn::Max(a, b);
}
template <class Vector>
RAYNEST_INLINE Vector flip_sign(Vector a, Vector b) {
    return hn::Xor(a, hn::And(b, hn::SignBit(Tag<Vector>())));
}
template <class Vector>
RAYNEST_INLINE Vector select(std::uint32_t mask, Vector a, Vector b) {
    const std::uint8_t bytes[8] = {static_cast<std::uint8_t>(mask),
                                   static_cast<std::uint8_t>(mask >> 8)};
    return hn::IfThenElse(hn::LoadMaskBits(Tag<Vector>(), bytes), a, b);
}
template <class Vector>
RAYNEST_INLINE float least(Vector a) {
    return hn::GetLane(hn::MinOfLanes(Tag<Vector>(), a));
}
template <class Vector>
RAYNEST_INLINE float most(Vector a) {
    return hn::GetLane(hn::MaxOfLanes(Tag<Vector>(), a));
}
template <class Vector>
RAYNEST_INLINE Vector fused(Vector a, Vector b, Vector c) {
    return hn::MulAdd(a, b, c);
}
template <class Vector>
RAYNEST_INLINE std::uint32_t bits(hn::Mask<Tag<Vector>> mask) {
    std::uint8_t bytes[8] = {};
    hn::StoreMaskBits(Tag<Vector>(), mask, bytes);
    if constexpr (width<Vector> <= 8) return bytes[0];
    std::uint16_t both;
    __builtin_memcpy(&both, bytes, sizeof both);
    return both;
}
template <class Vector>
RAYNEST_INLINE std::uint32_t negative(Vector a) {
    const hn::RebindToSigned<Tag<Vector>> i32;
    return bits<Vector>(hn::RebindMask(Tag<Vector>(), hn::BitCast(i32, a) < hn::Zero(i32)));
}
template <class Vector>
RAYNEST_INLINE std::uint32_t less(Vector a, Vector b) {
    return bits<Vector>(a < b);
}
template <class Vector>
RAYNEST_INLINE std::uint32_t less_equal(Vector a, Vector b) {
    return bits<Vector>(a <= b);
}

}  // namespace raynest::part
