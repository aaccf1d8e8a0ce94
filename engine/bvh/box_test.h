// The box rule of CONTRACT.md §1: one arithmetic for a single box and for the eight of a node.
//
//   d' = |d| < 1e-18 ? copysign(1e-18, d) : d      r = 1/d'      m = -o r
//   near plane = fma(p, r, m - e)                  far plane = fma(p, r, m + e)
//   near = max(tmin, max of near planes * (2 - 1.0000004))
//   far  = min(tmax, min of far planes * 1.0000004)            enter iff near <= far
//
// e = |r| * max(|ox|, |oy|, |oz|) * 2^-22 * ObjectRecord::origin_error. The contract's first wording
// had |o| per axis; with rotated instances the rounding of one axis moves another, so the largest one
// counts, times the growth through the levels below (scene/bake computes it). It only widens boxes.
// Boxes cull, they never decide a hit.
//
// Overflow (origins of 1e30 and more) may give NaN planes; minimum() and maximum() then drop the
// constraint, which widens the box, and Node::valid() keeps empty slots out.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "engine/bvh/node.h"
#include "engine/geometry/box.h"
#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"

namespace raynest {

inline constexpr float box_far_factor = 1.0000004F;
inline constexpr float box_near_factor = 2.0F - box_far_factor;
inline constexpr float box_origin_error = 0x1p-22F;
inline constexpr float direction_min = 1e-18F;

/// The ray's part of the rule for one axis.
struct SlabTerms {
    float reciprocal;
    float near_offset;
    float far_offset;

    RAYNEST_INLINE SlabTerms(float origin, float direction, float origin_max) {
        const float d = std::abs(direction) < direction_min
                            ? std::copysign(direction_min, direction)
                            : direction;
        reciprocal = 1.0F / d;
        const float m = -origin * reciprocal;
        const float e = std::abs(reciprocal) * origin_max;
        near_offset = m - e;
        far_offset = m + e;
    }
};

/// max |o| over the axes, times the error factor.
[[nodiscard]] RAYNEST_INLINE float origin_extent(const Vec3& origin, const ObjectRecord* object) {
    const float largest =
        std::max(std::max(std::abs(origin.x), std::abs(origin.y)), std::abs(origin.z));
    return largest * (object != nullptr ? object->origin_error * box_origin_error
                                        : box_origin_error);
}

/// A ray that enters a tree: the terms broadcast once, so that the node loop only loads rows.
struct BoxRay : RayView {
    Lanes<8> reciprocal[3];
    Lanes<8> near_offset[3];
    Lanes<8> far_offset[3];
    std::uint32_t near_row[3];  ///< 0: the ray meets lower[] first, 1: upper[]

    RAYNEST_INLINE explicit BoxRay(const RayView& ray) : RayView(ray) {
        const float extent = origin_extent(ray.origin, ray.object);
        for (int axis = 0; axis < 3; ++axis) {
            const SlabTerms terms(ray.origin[axis], ray.direction[axis], extent);
            reciprocal[axis] = Lanes<8>::splat(terms.reciprocal);
            near_offset[axis] = Lanes<8>::splat(terms.near_offset);
            far_offset[axis] = Lanes<8>::splat(terms.far_offset);
            near_row[axis] = std::signbit(terms.reciprocal) ? 1 : 0;
        }
    }
};

/// The children of a node.
struct Boxes8 {
    using box_tag = void;
    static constexpr int lanes = 8;
    const Node* node;

    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return node->valid(); }
    [[nodiscard]] Box box_of(int lane) const {
        return {{node->lower[0][lane], node->lower[1][lane], node->lower[2][lane]},
                {node->upper[0][lane], node->upper[1][lane], node->upper[2][lane]}};
    }
};

/// One box: what a plain list or the scalar reference asks.
struct BoxRef {
    using box_tag = void;
    static constexpr int lanes = 1;
    const Box* box;

    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return 1; }
    [[nodiscard]] const Box& box_of(int) const { return *box; }
};

/// One ray against the eight children of a node.
RAYNEST_INLINE Spans<Boxes8, 8> intersect(const BoxRay& ray, const Boxes8& boxes) {
    const float(*rows)[3][8] = &boxes.node->lower;  // lower and upper lie one behind the other
    static_assert(offsetof(Node, upper) == sizeof(Node::lower));
    const auto plane = [&](std::uint32_t row, int axis) {
        return Lanes<8>::load(rows[row][axis]);
    };
    const auto near_plane = [&](int axis) {
        return fused(plane(ray.near_row[axis], axis), ray.reciprocal[axis],
                     ray.near_offset[axis]);
    };
    const auto far_plane = [&](int axis) {
        return fused(plane(ray.near_row[axis] ^ 1U, axis), ray.reciprocal[axis],
                     ray.far_offset[axis]);
    };
    const auto near = maximum(
        maximum(near_plane(0), maximum(near_plane(1), near_plane(2))) *
            Lanes<8>::splat(box_near_factor),
        Lanes<8>::splat(ray.tmin));
    const auto far = minimum(
        minimum(far_plane(0), minimum(far_plane(1), far_plane(2))) *
            Lanes<8>::splat(box_far_factor),
        Lanes<8>::splat(ray.tmax));
    return {less_equal(near, far) & boxes.valid(), near, boxes};
}

/// One ray against one box, the same arithmetic.
template <class R>
RAYNEST_INLINE Spans<BoxRef, 1> intersect(const R& ray, const BoxRef& boxes) {
    using F = Lanes<1>;
    const float extent = origin_extent(ray.origin, ray.object);
    F near_planes[3];
    F far_planes[3];
    for (int axis = 0; axis < 3; ++axis) {
        const SlabTerms terms(ray.origin[axis], ray.direction[axis], extent);
        const bool from_above = std::signbit(terms.reciprocal);
        const Box& box = *boxes.box;
        const float first = from_above ? box.upper[axis] : box.lower[axis];
        const float second = from_above ? box.lower[axis] : box.upper[axis];
        near_planes[axis] = F::splat(fused(first, terms.reciprocal, terms.near_offset));
        far_planes[axis] = F::splat(fused(second, terms.reciprocal, terms.far_offset));
    }
    const F near = maximum(maximum(near_planes[0], maximum(near_planes[1], near_planes[2])) *
                               F::splat(box_near_factor),
                           F::splat(ray.tmin));
    const F far = minimum(minimum(far_planes[0], minimum(far_planes[1], far_planes[2])) *
                              F::splat(box_far_factor),
                          F::splat(ray.tmax));
    return {less_equal(near, far), near, boxes};
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Box& box) {
    return intersect(ray, BoxRef{&box});
}

}  // namespace raynest
