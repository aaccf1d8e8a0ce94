// The box rule of CONTRACT.md §1: where a ray enters and leaves an axis-aligned box.
//
//   d' = |d| < dmax * 1e-18 ? copysign(dmax * 1e-18, d) : d       r = 1/d'      m = -o r
//   near plane = fma(p, r, m - e)                                 far plane = fma(p, r, m + e)
//   near = max of near planes * (2 - 1.0000004)                   far = min of far planes
//   * 1.0000004 enter iff max(near, tmin) <= min(far, tmax)
//
// with dmax = max |d| and e = |r| * max |o| * 2^-22 * ObjectRecord::origin_error. Two things are
// wider than in the contract's first wording, because brute force found rays that it culled. The
// limit for small components is relative: a direction of 1e-30 is short, not axis-parallel. And the
// error is that of the largest coordinate, times its growth through the levels below (scene/bake
// computes it): inside a rotated instance the rounding of one axis moves another.
//
// An axis whose terms overflow constrains nothing.
//
// The rule is monotone, bit for bit: a box inside another one has a near that is not smaller and a
// far that is not larger, whatever the rounding. So a hit whose t lies between near and far of its
// own primitive's box can never be culled by a box around it: primitives hold their hits to that
// (clamp_to_own_box), and traversal and reference agree by construction. Grazing rays need it:
// there the rounding of t is divided by the sine of the angle, and no fixed padding is enough.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/ray_view.h"
#include "engine/math/lanes.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

namespace raynest {

inline constexpr float box_far_factor = 1.0000004F;
inline constexpr float box_near_factor = 2.0F - box_far_factor;
inline constexpr float box_origin_error = 0x1p-22F;
inline constexpr float direction_min_relative = 1e-18F;

[[nodiscard]] RAYNEST_INLINE float largest_component(const Vec3& v) {
    return std::max(std::max(std::abs(v.x), std::abs(v.y)), std::abs(v.z));
}

/// The ray's part of the rule, each term in all N lanes.
template <int N>
struct Slabs {
    Lanes<N> reciprocal[3];
    Lanes<N> near_offset[3];
    Lanes<N> far_offset[3];
    std::uint32_t near_row[3];  ///< 0: the ray meets the lower plane first, 1: the upper one

    RAYNEST_INLINE explicit Slabs(const RayView& ray) {
        const float error = ray.object != nullptr ? ray.object->origin_error : 1.0F;
        const float extent = largest_component(ray.origin) * (error * box_origin_error);
        const float smallest = largest_component(ray.direction) * direction_min_relative;
        for (int axis = 0; axis < 3; ++axis) set(axis, ray, extent, smallest);
    }

    /// t of the plane where the slab of an axis begins and ends.
    [[nodiscard]] RAYNEST_INLINE Lanes<N> near_plane(int axis, const Lanes<N>& p) const {
        return fused(p, reciprocal[axis], near_offset[axis]);
    }
    [[nodiscard]] RAYNEST_INLINE Lanes<N> far_plane(int axis, const Lanes<N>& p) const {
        return fused(p, reciprocal[axis], far_offset[axis]);
    }

private:
    RAYNEST_INLINE void set(int axis, const RayView& ray, float extent, float smallest) {
        const float direction = ray.direction[axis];
        const float d =
            std::abs(direction) < smallest ? std::copysign(smallest, direction) : direction;
        float r = 1.0F / d;
        const float m = -ray.origin[axis] * r;
        const float e = std::abs(r) * extent;
        float first = m - e;
        float second = m + e;
        if (!(std::abs(m) + e < std::numeric_limits<float>::max())) [[unlikely]] {
            r = std::copysign(0.0F, direction);
            first = -std::numeric_limits<float>::infinity();
            second = std::numeric_limits<float>::infinity();
        }
        reciprocal[axis] = Lanes<N>::splat(r);
        near_offset[axis] = Lanes<N>::splat(first);
        far_offset[axis] = Lanes<N>::splat(second);
        near_row[axis] = std::signbit(r) ? 1 : 0;
    }
};

/// A ray that enters a tree: the terms broadcast once, so that the node loop only loads rows.
struct BoxRay : RayView {
    Slabs<8> slabs;

    RAYNEST_INLINE explicit BoxRay(const RayView& ray) : RayView(ray), slabs(ray) {}
};

/// The terms in the width that is needed: kept by a BoxRay, else computed.
template <int N, class R>
[[nodiscard]] RAYNEST_INLINE decltype(auto) slabs_of(const R& ray) {
    if constexpr (N == 8 && requires { ray.slabs; }) {
        return (ray.slabs);
    } else {
        return Slabs<N>(ray);
    }
}

/// Where N rays' lanes enter and leave N boxes; empty where near > far.
template <int N>
struct Interval {
    Lanes<N> near, far;

    /// From the planes of the three axes.
    RAYNEST_INLINE static Interval of(const Lanes<N> (&near_planes)[3],
                                      const Lanes<N> (&far_planes)[3]) {
        return {maximum(near_planes[0], maximum(near_planes[1], near_planes[2])) *
                    Lanes<N>::splat(box_near_factor),
                minimum(far_planes[0], minimum(far_planes[1], far_planes[2])) *
                    Lanes<N>::splat(box_far_factor)};
    }
};

/// Where the ray passes the bounding boxes of N triangles. A box's plane is the least (or largest)
/// of the three vertices' planes, because fma is monotone: no box needs to be built.
template <int N>
[[nodiscard]] RAYNEST_INLINE Interval<N> own_interval(const Slabs<N>& slabs, const Lanes3<N>& v0,
                                                      const Lanes3<N>& v1, const Lanes3<N>& v2) {
    const auto near = [&](int axis, const Lanes<N>& a, const Lanes<N>& b, const Lanes<N>& c) {
        return minimum(slabs.near_plane(axis, a),
                       minimum(slabs.near_plane(axis, b), slabs.near_plane(axis, c)));
    };
    const auto far = [&](int axis, const Lanes<N>& a, const Lanes<N>& b, const Lanes<N>& c) {
        return maximum(slabs.far_plane(axis, a),
                       maximum(slabs.far_plane(axis, b), slabs.far_plane(axis, c)));
    };
    return Interval<N>::of(
        {near(0, v0.x, v1.x, v2.x), near(1, v0.y, v1.y, v2.y), near(2, v0.z, v1.z, v2.z)},
        {far(0, v0.x, v1.x, v2.x), far(1, v0.y, v1.y, v2.y), far(2, v0.z, v1.z, v2.z)});
}

/// Where the ray passes one box.
[[nodiscard]] RAYNEST_INLINE Interval<1> own_interval(const Slabs<1>& slabs, const Box& box) {
    const auto plane = [&](std::uint32_t row, int axis) {
        return Lanes<1>::splat(row == 0 ? box.lower[axis] : box.upper[axis]);
    };
    const auto near = [&](int axis) {
        return slabs.near_plane(axis, plane(slabs.near_row[axis], axis));
    };
    const auto far = [&](int axis) {
        return slabs.far_plane(axis, plane(slabs.near_row[axis] ^ 1U, axis));
    };
    return Interval<1>::of({near(0), near(1), near(2)}, {far(0), far(1), far(2)});
}

}  // namespace raynest
