// Lanes: N floats side by side, the only SIMD type that intersectors and kernels see.
//
// Lanes<4>, <8> and <16> are one or more Highway vectors of whatever target the pack is compiled
// for (static mode: -march decides); any other count is plain floats (scalar rays, the reference,
// CUDA). Masks are plain bits, lane i = bit i: free on AVX2 and AVX-512, and the same source for
// any width.
//
// NaN: maximum(a, b) and minimum(a, b) return b when either is NaN, as x86 does; the box rule
// counts on it (bvh/box_test.h).
#pragma once

#ifndef HWY_DISABLE_PCLMUL_AES
#error "define HWY_DISABLE_PCLMUL_AES: without it -march=x86-64-v2..v4 selects SSSE3 in Highway"
#endif
#ifndef HWY_COMPILE_ONLY_STATIC
#define HWY_COMPILE_ONLY_STATIC
#endif

#include "engine/math/vec.h"

#include <hwy/highway.h>

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest {

// One register, or one float: the same few operations on both.
namespace part {

namespace hn = hwy::HWY_NAMESPACE;
template <class Vector>
using Tag = hn::DFromV<Vector>;

/// What N lanes are made of.
template <int N>
struct PartOf {
    using type = float;
};
template <int N>
requires(N == 4 || N == 8 || N == 16) struct PartOf<N> {
    using type = hn::Vec<hn::CappedTag<float, static_cast<std::size_t>(N)>>;
};

template <class Part>
inline constexpr std::size_t width = hn::MaxLanes(Tag<Part>());
template <>
inline constexpr std::size_t width<float> = 1;

RAYNEST_INLINE void set(float& to, float value) {
    to = value;
}
RAYNEST_INLINE void load(float& to, const float* from) {
    to = *from;
}
RAYNEST_INLINE void load_unaligned(float& to, const float* from) {
    to = *from;
}
RAYNEST_INLINE void store(float a, float* to) {
    *to = a;
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
RAYNEST_INLINE std::uint32_t less(float a, float b) {
    return a < b ? 1 : 0;
}
RAYNEST_INLINE std::uint32_t less_equal(float a, float b) {
    return a <= b ? 1 : 0;
}

template <class Vector>
RAYNEST_INLINE void set(Vector& to, float value) {
    to = hn::Set(Tag<Vector>(), value);
}
template <class Vector>
RAYNEST_INLINE void load(Vector& to, const float* from) {
    to = hn::Load(Tag<Vector>(), from);
}
template <class Vector>
RAYNEST_INLINE void load_unaligned(Vector& to, const float* from) {
    to = hn::LoadU(Tag<Vector>(), from);
}
template <class Vector>
RAYNEST_INLINE void store(Vector a, float* to) {
    hn::Store(a, Tag<Vector>(), to);
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
RAYNEST_INLINE std::uint32_t less(Vector a, Vector b) {
    return bits<Vector>(a < b);
}
template <class Vector>
RAYNEST_INLINE std::uint32_t less_equal(Vector a, Vector b) {
    return bits<Vector>(a <= b);
}

}  // namespace part

template <int N>
struct Lanes {
    using Part = typename part::PartOf<N>::type;
    static constexpr std::size_t width = part::width<Part>;
    static constexpr std::size_t parts = static_cast<std::size_t>(N) / width;
    Part lane[parts];  ///< for plain floats the lanes themselves

    RAYNEST_INLINE static Lanes splat(float value) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::set(r.lane[i], value);
        return r;
    }
    /// x, y, z and one lane more, of 1.
    RAYNEST_INLINE static Lanes of(const Vec3& v) {
        static_assert(N == 4);
        alignas(16) const float from[4] = {v.x, v.y, v.z, 1.0F};
        if constexpr (width == 4) {
            // From registers: through memory the vector would wait for three stores.
            using Four [[gnu::vector_size(16)]] = float;
            const Four four = {v.x, v.y, v.z, 1.0F};
            return {Part{std::bit_cast<decltype(Part::raw)>(four)}};
        } else {
            return load(from);
        }
    }
    /// `from` is aligned to the N floats.
    RAYNEST_INLINE static Lanes load(const float* from) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::load(r.lane[i], from + i * width);
        return r;
    }
    /// The same from any address.
    RAYNEST_INLINE static Lanes load_unaligned(const float* from) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::load_unaligned(r.lane[i], from + i * width);
        return r;
    }
    /// `to` is aligned to the N floats.
    RAYNEST_INLINE void store(float* to) const {
        for (std::size_t i = 0; i < parts; ++i) part::store(lane[i], to + i * width);
    }

    /// f(part of a, part of b, ...) for every part.
    template <class F, class... Others>
    RAYNEST_INLINE static Lanes map(F&& f, const Others&... others) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) r.lane[i] = f(others.lane[i]...);
        return r;
    }
    template <class F>
    RAYNEST_INLINE static std::uint32_t test(F&& f, const Lanes& a, const Lanes& b) {
        std::uint32_t mask = 0;
        for (std::size_t i = 0; i < parts; ++i) mask |= f(a.lane[i], b.lane[i]) << (i * width);
        return mask;
    }
};

template <int N>
RAYNEST_INLINE Lanes<N> operator+(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::add(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE Lanes<N> operator-(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::subtract(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE Lanes<N> operator*(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::multiply(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE Lanes<N> operator/(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::divide(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE Lanes<N> minimum(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::minimum(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE Lanes<N> maximum(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::maximum(x, y); }, a, b);
}
/// a, negated where b is negative: a * sign(b) without a rounding.
template <int N>
RAYNEST_INLINE Lanes<N> flip_sign(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::flip_sign(x, y); }, a, b);
}
/// a in the lanes of `mask`, b in the others.
template <int N>
RAYNEST_INLINE Lanes<N> select(std::uint32_t mask, const Lanes<N>& a, const Lanes<N>& b) {
    Lanes<N> r;
    for (std::size_t i = 0; i < r.parts; ++i) {
        r.lane[i] = part::select(mask >> (i * r.width), a.lane[i], b.lane[i]);
    }
    return r;
}
/// The least and the largest of all lanes. No lane may be NaN.
template <int N>
RAYNEST_INLINE float least(const Lanes<N>& a) {
    float r = part::least(a.lane[0]);
    for (std::size_t i = 1; i < a.parts; ++i) r = part::minimum(r, part::least(a.lane[i]));
    return r;
}
template <int N>
RAYNEST_INLINE float most(const Lanes<N>& a) {
    float r = part::most(a.lane[0]);
    for (std::size_t i = 1; i < a.parts; ++i) r = part::maximum(r, part::most(a.lane[i]));
    return r;
}
/// a*b + c: one rounding where the target has FMA.
template <int N>
RAYNEST_INLINE Lanes<N> fused(const Lanes<N>& a, const Lanes<N>& b, const Lanes<N>& c) {
    return Lanes<N>::map([](auto x, auto y, auto z) { return part::fused(x, y, z); }, a, b, c);
}
/// Bit i: a < b in lane i. False where either is NaN.
template <int N>
RAYNEST_INLINE std::uint32_t less(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::test([](auto x, auto y) { return part::less(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE std::uint32_t less_equal(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::test([](auto x, auto y) { return part::less_equal(x, y); }, a, b);
}

/// A value of one ray in all lanes, or the lanes of N rays as they are: what lets one source test
/// one ray against N things, and N rays against one.
template <int N>
RAYNEST_INLINE Lanes<N> in_lanes(float value) {
    return Lanes<N>::splat(value);
}
template <int N>
RAYNEST_INLINE const Lanes<N>& in_lanes(const Lanes<N>& values) {
    return values;
}

}  // namespace raynest
