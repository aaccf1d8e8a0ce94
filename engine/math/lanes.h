// Lanes: N floats side by side, the only SIMD type that intersectors and kernels use.
//
// Lanes<4>, <8> and <16> are one or more vectors of the pack's target; any other count is plain
// floats (scalar rays, the reference). With RAYNEST_PLAIN_LANES every count is plain floats: CUDA
// compiles the same sources this way. Masks are plain bits, lane i = bit i: free on AVX2 and
// AVX-512, and the same source for any width.
//
// NaN: maximum(a, b) and minimum(a, b) return b when either is NaN, as x86 does; the box rule
// relies on it (bvh/box_test.h).
#pragma once

#ifdef RAYNEST_PLAIN_LANES
#include "engine/math/part.h"
#else
#include "engine/math/highway_part.h"
#endif

#include "engine/math/mask.h"
#include "engine/math/vec.h"

#include <cstddef>
#include <cstdint>

namespace raynest {

template <int N>
struct Lanes {
    using Part = typename part::PartOf<N>::type;
    static constexpr std::size_t width = part::width<Part>;
    static constexpr std::size_t parts = static_cast<std::size_t>(N) / width;
    Part lane[parts];  ///< for plain floats, the lanes themselves

    RAYNEST_INLINE static Lanes splat(float value) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::set(r.lane[i], value);
        return r;
    }
    /// Returns x, y, z and a fourth lane of 1.
    RAYNEST_INLINE static Lanes of(const Vec3& v) {
        static_assert(N == 4);
#ifndef RAYNEST_PLAIN_LANES
        if constexpr (width == 4) return {part::of<Part>(v)};
#endif
        alignas(16) const float from[4] = {v.x, v.y, v.z, 1.0F};
        return load(from);
    }
    /// Returns the first three lanes.
    [[nodiscard]] RAYNEST_INLINE Vec3 to_vec3() const {
        static_assert(N == 4);
#ifndef RAYNEST_PLAIN_LANES
        if constexpr (width == 4) return part::to_vec3(lane[0]);
#endif
        alignas(16) float to[4];
        store(to);
        return {to[0], to[1], to[2]};
    }
    /// Returns lanes `axis` + 1 and + 2, counted in a circle of three, then lane `axis`.
    [[nodiscard]] RAYNEST_INLINE Lanes turned_to(std::uint32_t axis) const {
        static_assert(N == 4);
#ifndef RAYNEST_PLAIN_LANES
        if constexpr (width == 4) return {part::turned_to(lane[0], axis)};
#endif
        alignas(16) float from[4];
        store(from);
        const std::uint32_t next = (1U << axis) & 3U;  // 1, 2, 0
        alignas(16) const float to[4] = {from[next], from[axis ^ next ^ 3U], from[axis], from[3]};
        return load(to);
    }
    /// Loads the columns of a map, each into the first three lanes.
    RAYNEST_INLINE static void load_columns(Lanes (&to)[4], const ColumnTransform& map) {
        static_assert(N == 4);
#ifndef RAYNEST_PLAIN_LANES
        if constexpr (width == 4) {
            Part columns[4];
            part::load_columns(columns, map.m.data());
            for (int k = 0; k < 4; ++k) to[k].lane[0] = columns[k];
            return;
        }
#endif
        for (std::size_t k = 0; k < 4; ++k) {
            alignas(16)
                const float column[4] = {map.m[3 * k], map.m[3 * k + 1], map.m[3 * k + 2], 0};
            to[k] = load(column);
        }
    }
    /// Loads N floats; `from` is aligned to their size.
    RAYNEST_INLINE static Lanes load(const float* from) {
        Lanes r;
        for (std::size_t i = 0; i < parts; ++i) part::load(r.lane[i], from + i * width);
        return r;
    }
    /// Stores N floats; `to` is aligned to their size.
    RAYNEST_INLINE void store(float* to) const {
        for (std::size_t i = 0; i < parts; ++i) part::store(lane[i], to + i * width);
    }
    /// Transposes N consecutive records of eight floats: lane i of to[k] is float k of record i.
    RAYNEST_INLINE static void load_records(Lanes (&to)[8], const float* from) {
        for (std::size_t i = 0; i < parts; ++i) {
            Part columns[8];
            part::load_records(columns, from + 8 * width * i);
            for (int k = 0; k < 8; ++k) to[k].lane[i] = columns[k];
        }
    }

    /// Returns f(part of a, part of b, ...) for every part.
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
/// Returns a, negated where b is negative: a * sign(b) without a rounding.
template <int N>
RAYNEST_INLINE Lanes<N> flip_sign(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::map([](auto x, auto y) { return part::flip_sign(x, y); }, a, b);
}
/// Returns a in the lanes of `mask`, b in the others.
template <int N>
RAYNEST_INLINE Lanes<N> select(std::uint32_t mask, const Lanes<N>& a, const Lanes<N>& b) {
    Lanes<N> r;
    for (std::size_t i = 0; i < r.parts; ++i) {
        r.lane[i] = part::select(mask >> (i * r.width), a.lane[i], b.lane[i]);
    }
    return r;
}
/// Return the least and the largest of all lanes. No lane may be NaN.
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
/// Returns a*b + c, with one rounding if the target has FMA.
template <int N>
RAYNEST_INLINE Lanes<N> fused(const Lanes<N>& a, const Lanes<N>& b, const Lanes<N>& c) {
    return Lanes<N>::map([](auto x, auto y, auto z) { return part::fused(x, y, z); }, a, b, c);
}
/// Returns the lanes' sign bits, also those of zeros: bit i for lane i.
template <int N>
RAYNEST_INLINE std::uint32_t negative(const Lanes<N>& a) {
    std::uint32_t mask = 0;
    for (std::size_t i = 0; i < a.parts; ++i) mask |= part::negative(a.lane[i]) << (i * a.width);
    return mask;
}
/// Returns a mask: bit i is set if a < b in lane i; clear if either is NaN.
template <int N>
RAYNEST_INLINE std::uint32_t less(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::test([](auto x, auto y) { return part::less(x, y); }, a, b);
}
template <int N>
RAYNEST_INLINE std::uint32_t less_equal(const Lanes<N>& a, const Lanes<N>& b) {
    return Lanes<N>::test([](auto x, auto y) { return part::less_equal(x, y); }, a, b);
}

/// Calls f(lane) for every lane in `mask`, in ascending order.
template <int N, class F>
RAYNEST_INLINE void for_each_lane(std::uint32_t mask, F&& f) {
#ifdef RAYNEST_PLAIN_LANES
    // Constant lane numbers keep the lanes in registers.
    for (int lane = 0; lane < N; ++lane) {
        if ((mask >> lane & 1U) != 0) f(lane);
    }
#else
    for (; mask != 0; mask &= mask - 1) f(static_cast<int>(lowest_bit(mask)));
#endif
}

/// Returns one ray's value in all lanes, or the lanes of N rays unchanged. So the same source tests
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
