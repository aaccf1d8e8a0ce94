// Ray against box: the eight children of a node, or one box, with the rule of geometry/slabs.h.
//
// Boxes cull, they never decide a hit; `near` orders the children.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/box.h"
#include "engine/geometry/box_ray.h"
#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"
#include "engine/geometry/slabs.h"

#include <cstddef>
#include <cstdint>

namespace raynest {

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

/// One box: what a plain list or a scalar walk asks.
struct BoxRef {
    using box_tag = void;
    static constexpr int lanes = 1;
    const Box* box;

    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return 1; }
    [[nodiscard]] RAYNEST_FN const Box& box_of(int) const { return *box; }
};

/// The boxes that the ray enters within [tmin, tmax].
template <class B, int N>
RAYNEST_INLINE Spans<B, N> entered(const RayView& ray, const Interval<N>& interval,
                                   const B& boxes) {
    const auto near = maximum(interval.near, Lanes<N>::splat(ray.tmin));
    const auto far = minimum(interval.far, Lanes<N>::splat(ray.tmax));
    return {less_equal(near, far) & boxes.valid(), near, boxes};
}

RAYNEST_INLINE Spans<Boxes8, 8> intersect(const BoxRay& ray, const Boxes8& boxes) {
    const float(*rows)[3][8] = &boxes.node->lower;  // lower and upper lie one behind the other
    static_assert(offsetof(Node, upper) == sizeof(Node::lower));
    const Slabs& slabs = ray.slabs;
    const auto near = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.near_plane(axis, Lanes<8>::load(rows[slabs.near_row[axis]][axis]));
    };
    const auto far = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.far_plane(axis, Lanes<8>::load(rows[slabs.near_row[axis] ^ 1U][axis]));
    };
    return entered(ray, Interval<8>::of({near(0), near(1), near(2)}, {far(0), far(1), far(2)}),
                   boxes);
}

template <class R>
RAYNEST_INLINE Spans<BoxRef, 1> intersect(const R& ray, const BoxRef& boxes) {
    return entered(ray, own_interval(slabs_of(ray), *boxes.box), boxes);
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Box& box) {
    return intersect(ray, BoxRef{&box});
}

}  // namespace raynest
