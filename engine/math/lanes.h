// Lanes: N floats side by side, the only SIMD type that intersectors and kernels see.
//
// Lanes<8> is one or two Highway vectors of whatever target the pack is compiled for (static mode:
// -march decides); any other count is plain floats (scalar rays, the reference, CUDA). Masks are
// plain bits, lane i = bit i: free on AVX2 and AVX-512, and the same source for any width.
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

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest {

// One register, or one float: the same few operations on both.
namespace part {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<float, 8>;
using Vector = hn::Vec<Tag>;

template <class Part>
inline constexpr std::size_t width = 1;
template <>
inline constexpr std::size_t width<Vector> = hn::MaxLanes(Tag());

RAYNEST_INLINE void set(float& to, float value) {
    to = value;
}
RAYNEST_INLINE void load(float& to, const float* from) {
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
RAYNEST_INLINE float fused(float a, float b, float c) {
    return raynest::fused(a, b, c);
}
RAYNEST_INLINE float fused_subtract(float a, float b, float c) {
    return raynest::fused(a, b, -c);
}
RAYNEST_INLINE std::uint32_t less(float a, float b) {
    return a < b ? 1 : 0;
}
RAYNEST_INLINE std::uint32_t less_equal(float a, float b) {
    return a <= b ? 1 : 0;
}

RAYNEST_INLINE void set(Vector& to, float value) {
    to = hn::Set(Tag(), value);
}
RAYNEST_INLINE void load(Vector& to, const float* from) {
    to = hn::Load(Tag(), from);
}
RAYNEST_INLINE void store(Vector a, float* to) {
    hn::Store(a, Tag(), to);
}
RAYNEST_INLINE Vector add(Vector a, Vector b) {
    return a + b;
}
RAYNEST_INLINE Vector subtract(Vector a, Vector b) {
    return a - b;
}
RAYNEST_INLINE Vector multiply(Vector a, Vector b) {
    return a * b;
}
RAYNEST_INLINE Vector divide(Vector a, Vector b) {
    return a / b;
}
RAYNEST_INLINE Vector minimum(Vector a, Vector b) {
    return hn::Min(a, b);
}
RAYNEST_INLINE Vector maximum(Vector a, Vector b) {
    return hn::Max(a, b);
}
RAYNEST_INLINE Vector flip_sign(Vector a, Vector b) {
    return hn::Xor(a, hn::And(b, hn::SignBit(Tag())));
}
RAYNEST_INLINE Vector fused(Vector a, Vector b, Vector c) {
    return hn::MulAdd(a, b, c);
}
RAYNEST_INLINE Vector fused_subtract(Vector a, Vector b, Vector c) {
    return hn::MulSub(a, b, c);
}
RAYNEST_INLINE std::uint32_t bits(hn::Mask<Tag> mask) {
    std::uint8_t byte[8] = {};
    hn::StoreMaskBits(Tag(), mask, byte);
    return byte[0];
}
RAYNEST_INLINE std::uint32_t less(Vector a, Vector b) {
    return bits(a < b);
}
RAYNEST_INLINE std::uint32_t less_equal(Vector a, Vector b) {
    return bits(a <= b);
}

}  // namespace part

template <int N>
struct Lanes {
    using Part = std::conditional_t<N == 8, part::Vector, float>;
    static constexpr std::size_t width = part::width<Part>;
    static constexpr std::size_t parts = static_cast<std::size_t>(N) / width;
    Part lane[parts];  ///< for N != 8 the lanes themselves

    RAYNEST_INLINE static Lanes splat(float value) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::set(r.lane[i], value);
        return r;
    }
    /// `from` is aligned to 32 bytes when N is 8.
    RAYNEST_INLINE static Lanes load(const float* from) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::load(r.lane[i], from + i * width);
        return r;
    }
    /// `to` is aligned to 32 bytes when N is 8.
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
/// a*b + c: one rounding where the target has FMA.
template <int N>
RAYNEST_INLINE Lanes<N> fused(const Lanes<N>& a, const Lanes<N>& b, const Lanes<N>& c) {
    return Lanes<N>::map([](auto x, auto y, auto z) { return part::fused(x, y, z); }, a, b, c);
}
/// a*b - c: one rounding where the target has FMA.
template <int N>
RAYNEST_INLINE Lanes<N> fused_subtract(const Lanes<N>& a, const Lanes<N>& b, const Lanes<N>& c) {
    return Lanes<N>::map([](auto x, auto y, auto z) { return part::fused_subtract(x, y, z); }, a, b,
                         c);
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

/// Three coordinates of N points.
template <int N>
struct Lanes3 {
    Lanes<N> x, y, z;

    RAYNEST_INLINE static Lanes3 splat(const Vec3& v) {
        return {Lanes<N>::splat(v.x), Lanes<N>::splat(v.y), Lanes<N>::splat(v.z)};
    }
};

template <int N>
RAYNEST_INLINE Lanes3<N> operator-(const Lanes3<N>& a, const Lanes3<N>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}

/// The order of operations is part of the contract: the same on every target and width.
template <int N>
RAYNEST_INLINE Lanes3<N> cross(const Lanes3<N>& a, const Lanes3<N>& b) {
    return {fused_subtract(a.y, b.z, a.z * b.y), fused_subtract(a.z, b.x, a.x * b.z),
            fused_subtract(a.x, b.y, a.y * b.x)};
}

template <int N>
RAYNEST_INLINE Lanes<N> dot(const Lanes3<N>& a, const Lanes3<N>& b) {
    return fused(a.x, b.x, fused(a.y, b.y, a.z * b.z));
}

}  // namespace raynest
