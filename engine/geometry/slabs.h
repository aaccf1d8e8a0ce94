// The box rule: where a ray enters and leaves an axis-aligned box.
//
//   d' = |d| < dmax * 1e-18 ? copysign(dmax * 1e-18, d) : d       r = 1/d'      m = -o r
//   near plane = fma(p, r n, (m - e) n)    n = 2 - 1.0000004      near = max of near planes
//   far plane  = fma(p, r f, (m + e) f)    f = 1.0000004          far = min of far planes
//   enter iff max(near, tmin) <= min(far, tmax)
//
// with dmax = max |d| and e = |r| * max |o| * 2^-21 * ObjectRecord::origin_error. The factors n and
// f are multiplied into the ray's terms once, not onto every node's result: two multiplications
// less on the path that a node's children wait for; e covers the roundings that this adds. Narrower
// rules cull rays that hit (found by brute force): the limit for small components is relative,
// because a direction of 1e-30 is short, not axis-parallel, and the error is that of the largest
// coordinate, times its growth through the levels below (scene/build.cpp computes it), because
// inside a rotated instance the rounding of one axis moves another.
//
// An axis whose terms overflow constrains nothing.
//
// The rule is monotone, bit for bit: a box inside another one has a near that is not smaller and a
// far that is not larger, whatever the rounding. So a hit whose t lies between near and far of its
// own primitive's box can never be culled by a box around it: primitives hold their hits to that
// (own_interval), and traversal and reference agree by construction. Grazing rays need it:
// there the rounding of t is divided by the sine of the angle, and no fixed padding is enough.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/ray_view.h"
#include "engine/math/lanes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

namespace raynest {

inline constexpr float box_far_factor = 1.0000004F;
inline constexpr float box_near_factor = 2.0F - box_far_factor;
inline constexpr float box_origin_error = 0x1p-21F;
inline constexpr float direction_min_relative = 1e-18F;

/// 1 / direction of the rule, in the first three lanes.
[[nodiscard]] RAYNEST_INLINE Lanes<4> limited_reciprocal(const Vec3& direction) {
    const auto d = Lanes<4>::of(direction);
    const auto smallest = Lanes<4>::splat(largest_component(direction) * direction_min_relative);
    const auto one = Lanes<4>::splat(1);
    // Hardly any ray needs the limit, and the division would wait 20 cycles for it: that is 3 % of
    // the time where rays enter instances.
    const auto reciprocal = one / d;
    if ((less(flip_sign(d, d), smallest) & 7U) == 0) [[likely]]
        return reciprocal;
    return one / flip_sign(maximum(flip_sign(d, d), smallest), d);
}

/// Which planes a ray meets first, by its octant.
struct alignas(16) Places {
    std::uint32_t octant;  ///< bit a: the ray runs down axis a
    /// Where, per axis, the planes that the ray meets first begin in rows of eight: lower x, y, z are
    /// the rows 0 to 2, upper ones 3 to 5.
    std::uint32_t near_place[3];

    /// Where the planes begin that the ray meets last.
    [[nodiscard]] RAYNEST_INLINE std::uint32_t far_place(int axis) const {
        return static_cast<std::uint32_t>(16 * axis + 24) - near_place[axis];
    }

    RAYNEST_FN static constexpr Places of(std::uint32_t octant) {
        Places r{octant, {}};
        for (std::uint32_t axis = 0; axis < 3; ++axis) {
            r.near_place[axis] = 8 * axis + 24 * (octant >> axis & 1U);
        }
        return r;
    }
};
inline constexpr std::array<Places, 8> places_of_octants = [] {
    std::array<Places, 8> places{};
    for (std::uint32_t octant = 0; octant < 8; ++octant) places[octant] = Places::of(octant);
    return places;
}();

/// The ray's part of the rule. All axes are computed at once: entering an instance costs this.
struct Slabs : Places {
    alignas(16) float near_scale[4];
    float near_offset[4];
    float far_scale[4];
    float far_offset[4];
    RAYNEST_INLINE explicit Slabs(const RayView& ray) {
        using F = Lanes<4>;
        const float growth = ray.object != nullptr ? ray.object->origin_error : 1.0F;
        const F extent = F::splat(largest_component(ray.origin) * (growth * box_origin_error));
        const F r = limited_reciprocal(ray.direction);
        const F m = F::of(-ray.origin) * r;
        const F e = flip_sign(r, r) * extent;
        (r * F::splat(box_near_factor)).store(near_scale);
        ((m - e) * F::splat(box_near_factor)).store(near_offset);
        (r * F::splat(box_far_factor)).store(far_scale);
        ((m + e) * F::splat(box_far_factor)).store(far_offset);
        // Not of the reciprocals: the rows that a node's test loads wait for it.
        const std::uint32_t sign_bits = negative(F::of(ray.direction)) & 7U;
#ifdef RAYNEST_PLAIN_LANES
        static_cast<Places&>(*this) = Places::of(sign_bits);
#else
        static_cast<Places&>(*this) = places_of_octants[sign_bits];
#endif
        const std::uint32_t finite = less((flip_sign(m, m) + e) * F::splat(box_far_factor),
                                          F::splat(std::numeric_limits<float>::max()));
        if ((finite & 7U) != 7U) [[unlikely]]
            widen(finite);
    }

    /// Whether the ray runs down the axis. Told by the place: by the octant a kernel for GPUs spills.
    [[nodiscard]] RAYNEST_INLINE bool is_backwards(int axis) const {
        return near_place[axis] >= 24;
    }

    /// t of the plane where the slab of an axis begins and ends.
    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes<N> near_plane(int axis, const Lanes<N>& p) const {
        return fused(p, Lanes<N>::splat(near_scale[axis]), Lanes<N>::splat(near_offset[axis]));
    }
    template <int N>
    [[nodiscard]] RAYNEST_INLINE Lanes<N> far_plane(int axis, const Lanes<N>& p) const {
        return fused(p, Lanes<N>::splat(far_scale[axis]), Lanes<N>::splat(far_offset[axis]));
    }

private:
    /// Axes whose terms overflow constrain nothing.
    RAYNEST_FN void widen(std::uint32_t finite) {
        for (int axis = 0; axis < 3; ++axis) {
            if ((finite >> axis & 1U) != 0) continue;
            near_scale[axis] = far_scale[axis] = std::copysign(0.0F, near_scale[axis]);
            near_offset[axis] = -std::numeric_limits<float>::infinity();
            far_offset[axis] = std::numeric_limits<float>::infinity();
        }
    }
};

/// Kept by a ray that enters a tree, else computed.
template <class R>
[[nodiscard]] RAYNEST_INLINE decltype(auto) slabs_of(const R& ray) {
    if constexpr (requires { ray.slabs; }) {
        return (ray.slabs);
    } else {
        return Slabs(ray);
    }
}

/// Where N rays' lanes enter and leave N boxes; empty where near > far.
template <int N>
struct Interval {
    Lanes<N> near, far;

    /// From the planes of the three axes.
    RAYNEST_INLINE static Interval of(const Lanes<N> (&near_planes)[3],
                                      const Lanes<N> (&far_planes)[3]) {
        return {maximum(near_planes[0], maximum(near_planes[1], near_planes[2])),
                minimum(far_planes[0], minimum(far_planes[1], far_planes[2]))};
    }
};

/// Where the ray passes the bounding boxes of N triangles. A box's plane is the least (or largest)
/// of the three vertices' planes, because fma is monotone: no box needs to be built.
template <int N, class S, class T>
[[nodiscard]] RAYNEST_INLINE Interval<N> own_interval(const S& slabs, const T& triangles) {
    const auto corner = [&](int k, int axis) RAYNEST_INLINE_LAMBDA {
        return triangles.template coordinate<N>(k, static_cast<std::uint32_t>(axis));
    };
    const auto near = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return minimum(slabs.near_plane(axis, corner(0, axis)),
                       minimum(slabs.near_plane(axis, corner(1, axis)),
                               slabs.near_plane(axis, corner(2, axis))));
    };
    const auto far = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return maximum(slabs.far_plane(axis, corner(0, axis)),
                       maximum(slabs.far_plane(axis, corner(1, axis)),
                               slabs.far_plane(axis, corner(2, axis))));
    };
    return Interval<N>::of({near(0), near(1), near(2)}, {far(0), far(1), far(2)});
}

/// Where the ray passes one box.
[[nodiscard]] RAYNEST_INLINE Interval<1> own_interval(const Slabs& slabs, const Box& box) {
    const auto plane = [&](bool upper, int axis) RAYNEST_INLINE_LAMBDA {
        return Lanes<1>::splat(upper ? box.upper[axis] : box.lower[axis]);
    };
    const auto near = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.near_plane(axis, plane(slabs.is_backwards(axis), axis));
    };
    const auto far = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.far_plane(axis, plane(!slabs.is_backwards(axis), axis));
    };
    return Interval<1>::of({near(0), near(1), near(2)}, {far(0), far(1), far(2)});
}

}  // namespace raynest
