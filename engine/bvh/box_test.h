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

/// The ray's own range joins the first axis: one step less between a node and its children, for
/// each of which a search waits (measured: 1 to 2 % of any hits by the single traversal). It comes
/// last of all, so that a plane that is NaN constrains nothing (math/lanes.h).
RAYNEST_INLINE Spans<Boxes8, 8> intersect(const BoxRay& ray, const Boxes8& boxes) {
    const float(*rows)[8] = boxes.node->lower;  // lower and upper lie one behind the other
    static_assert(offsetof(Node, upper) == sizeof(Node::lower));
    const Slabs& slabs = ray.slabs;
    const auto near = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.near_plane(axis, Lanes<8>::load(rows[slabs.near_row[axis]]));
    };
    const auto far = [&](int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.far_plane(axis, Lanes<8>::load(rows[slabs.far_row(axis)]));
    };
    const auto enters =
        maximum(maximum(near(1), near(2)), maximum(near(0), Lanes<8>::splat(ray.tmin)));
    const auto leaves =
        minimum(minimum(far(1), far(2)), minimum(far(0), Lanes<8>::splat(ray.tmax)));
    return {less_equal(enters, leaves) & boxes.valid(), enters, boxes};
}

template <class R>
RAYNEST_INLINE Spans<BoxRef, 1> intersect(const R& ray, const BoxRef& boxes) {
    const auto own = own_interval(slabs_of(ray), *boxes.box);
    const auto enters = maximum(own.near, Lanes<1>::splat(ray.tmin));
    const auto leaves = minimum(own.far, Lanes<1>::splat(ray.tmax));
    return {less_equal(enters, leaves), enters, boxes};
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Box& box) {
    return intersect(ray, BoxRef{&box});
}

}  // namespace raynest
