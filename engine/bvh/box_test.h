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

/// The children that a ray enters before tmax.
struct NodeSpans : Spans<Boxes8, 8> {
    Lanes<8> leaves;  ///< where the ray leaves the children, tmax at most
};

/// The rule for a node's children. `near(planes, axis)` and `far` give where the ray meets them.
///
/// The ray's own range joins the first axis: one step less between a node and its children, for
/// each of which a search waits (measured: 1 to 2 % of any hits by the single traversal). It comes
/// last of all, so that a plane that is NaN constrains nothing (math/lanes.h).
template <class Near, class Far>
RAYNEST_INLINE NodeSpans spans_of(const Node& node, Near&& near, Far&& far, const Lanes<8>& tmin,
                                  const Lanes<8>& tmax) {
    const float* planes = node.lower[0];  // lower and upper lie one behind the other
    static_assert(offsetof(Node, upper) == sizeof(Node::lower));
    const auto enters =
        maximum(maximum(near(planes, 1), near(planes, 2)), maximum(near(planes, 0), tmin));
    const auto leaves =
        minimum(minimum(far(planes, 1), far(planes, 2)), minimum(far(planes, 0), tmax));
    return {{less_equal(enters, leaves) & node.valid(), enters, Boxes8{&node}}, leaves};
}

RAYNEST_INLINE NodeSpans intersect(const BoxRay& ray, const Boxes8& boxes) {
    const Slabs& slabs = ray.slabs;
    const auto near = [&](const float* planes, int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.near_plane(axis, Lanes<8>::load(planes + slabs.near_place[axis]));
    };
    const auto far = [&](const float* planes, int axis) RAYNEST_INLINE_LAMBDA {
        return slabs.far_plane(axis, Lanes<8>::load(planes + slabs.far_place(axis)));
    };
    return spans_of(*boxes.node, near, far, Lanes<8>::splat(ray.tmin), Lanes<8>::splat(ray.tmax));
}

/// intersect() of one ray with many nodes, until its tmax changes. What does not change lies in
/// registers: a traversal that asks the ray instead loads it anew for every node.
class NodeTest {
public:
    RAYNEST_INLINE explicit NodeTest(const BoxRay& ray)
        : tmin_(F::splat(ray.tmin)),
          tmax_(F::splat(ray.tmax)) {
        const Slabs& slabs = ray.slabs;
        for (int axis = 0; axis < 3; ++axis) {
            near_[axis] = {F::splat(slabs.near_scale[axis]), F::splat(slabs.near_offset[axis]),
                           slabs.near_place[axis]};
            far_[axis] = {F::splat(slabs.far_scale[axis]), F::splat(slabs.far_offset[axis]),
                          slabs.far_place(axis)};
        }
    }

    [[nodiscard]] RAYNEST_INLINE NodeSpans operator()(const Node& node) const {
        const auto near = [&](const float* planes, int axis)
                              RAYNEST_INLINE_LAMBDA { return near_[axis].of(planes); };
        const auto far = [&](const float* planes, int axis)
                             RAYNEST_INLINE_LAMBDA { return far_[axis].of(planes); };
        return spans_of(node, near, far, tmin_, tmax_);
    }

private:
    using F = Lanes<8>;
    struct Terms {
        F scale, offset;
        std::size_t place;

        [[nodiscard]] RAYNEST_INLINE F of(const float* planes) const {
            return fused(F::load(planes + place), scale, offset);
        }
    };
    F tmin_, tmax_;
    Terms near_[3], far_[3];
};

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
