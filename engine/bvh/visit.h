// Visits all that a ray can hit: a triangle, a record, a BVH, an instance of a BVH.
//
// One overload set; each hands the intersector and the query on, so nesting has no special case and
// no fixed depth. `query.take(ray, hits)` keeps what it wants, shrinks ray.tmax and returns true
// when the whole query is answered; every visit passes that on.
//
// This is the single traversal: one ray, near children first, a stack of (child, near) per level
// and recursion between levels (measured: no slower than one explicit stack). Depth is bounded by
// scene_depth_max, the stack by tree_height_max; both are checked when a scene is made, not here.
//
// A single ray does not keep a CPU busy: from a node to the next it waits for memory, then for the
// box test, then for a mispredicted branch. So nodes that wait on top of the stack are looked at
// together with the one whose turn it is, and their waits overlap. Of any hits nothing is lost:
// what waits is looked at anyway, unless a hit ends the search. Of closest hits some are nodes that
// a hit would have culled. Camera rays pay for those, because their nearest leaf mostly has the hit.
// But they take nearly the same way one after the other, and a guess at it does not wait at all.
#pragma once

#include "engine/bvh/box_test.h"
#include "engine/bvh/cancellation.h"
#include "engine/bvh/guesses.h"
#include "engine/bvh/intersect_with.h"
#include "engine/bvh/node.h"
#include "engine/bvh/tree_arrays.h"
#include "engine/bvh/visit_primitive.h"
#include "engine/math/compact.h"
#include "engine/math/mask.h"

#include <bit>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <type_traits>

namespace raynest {

template <class Isect, class Query>
bool visit_tree(BoxRay& ray, const Bvh& bvh, Isect& isect, Query& query);

template <class R, class Isect, class Query>
RAYNEST_INLINE bool visit(R& ray, const Instance& instance, Isect& isect, Query& query) {
    const InstanceRecord& record = instance.record();
    if ((record.mask & ray.mask) == 0) {
        if constexpr (requires { isect.passes_by(ray, instance); }) isect.passes_by(ray, instance);
        return false;
    }
    if (!enters(isect, ray, instance)) return false;
    const ObjectRecord& object = instance.scene->objects[record.object];
    if (is_cancelled(query.cancellation, work_in(object))) return true;
    BoxRay inner(enter(ray, *instance.scene, record));
    const bool done = visit_tree(inner, Bvh{instance.scene, record.object}, isect, query);
    ray.tmax = inner.tmax;
    return done;
}

/// Shift of Node::order that sorts a node's children for the ray, farthest first.
[[nodiscard]] RAYNEST_INLINE std::uint32_t far_first(const BoxRay& ray) {
    return 3 * (ray.slabs.octant ^ 7U);
}

/// Nodes that one ray looks at together, at most. Measured against one, on terrain, cards and
/// interior: any hits 1.14 (AVX-512) and 1.06 (AVX2), diffuse rays 1.14 and 1.08, random rays 1.12
/// and 1.06, camera rays 0.98 and 0.93; four are no more than three. Where eight lanes are two
/// vectors there is less idle time to fill: two, which give 0.97 of one over all, against 0.87.
inline constexpr std::uint32_t nodes_together = Lanes<8>::parts == 1 ? 3 : 2;

/// From so many on an object's records of instances fill a core's cache, and those of the next two
/// are asked for before one is entered. Measured: 1.05 times as fast with 100,000 instances (camera
/// rays as before). With 2,000 it would be 0.98 to 1.00, with 10,000 between 0.98 and 1.04.
inline constexpr std::uint32_t many_instances = 1 << 14;

/// The single traversal of one tree. `With` guesses it is for one of several rays that take nearly
/// the same way, and looks at one node at a time.
template <class With = std::nullptr_t, class Isect, class Query>
RAYNEST_INLINE bool traverse(BoxRay& ray, const Bvh& bvh, Isect& isect, Query& query,
                             [[maybe_unused]] With* guesses = nullptr) {
    constexpr bool guessing = std::is_base_of_v<Guesses, With>;
    const SceneView& scene = *bvh.scene;
    const ObjectRecord& object = scene.objects[bvh.object];
    const TreeArrays arrays(scene, object);
    const std::uint32_t order = far_first(ray);
    std::uint32_t child = object.root;
    if (child == child_empty) return false;

    // The waiting children: their words, and where the ray enters them. What is deeper in the tree
    // lies above, so of each depth the children of one look wait at most. At the bottom lies a
    // leaf, where whoever looks for nodes stops; packing writes eight entries behind the top.
    constexpr std::size_t stack = 1 + 8 * nodes_together * tree_height_max + 8;
    std::uint32_t children[stack];
    float nears[stack];
    children[0] = child_empty;
    std::uint32_t top = 1;

    /// Is that entry, counted from the top, a node that is not behind the best hit?
    const auto waits = [&](std::uint32_t place) RAYNEST_INLINE_LAMBDA {
        return !is_leaf(children[top - place]) &&
               (!Query::ordered || nears[top - place] <= ray.tmax);
    };
    const auto waiting = [&](std::uint32_t place) RAYNEST_INLINE_LAMBDA -> const Node& {
        return arrays.node(children[top - place]);
    };
    /// Asks for the record of an instance that is that entry; if it is none, for one that is here.
    const auto ask_for_instance = [&](std::uint32_t place) RAYNEST_INLINE_LAMBDA {
        const std::uint32_t word = children[top >= place ? top - place : 0];
        const std::uint32_t other =
            is_leaf(word) && kind_of(word) == ChildKind::instance ? word : child;
        __builtin_prefetch(scene.instances + object.first_instance + leaf_instance(other));
    };
    const auto push = [&](const Node& node, const auto& spans) RAYNEST_INLINE_LAMBDA {
        if constexpr (Query::ordered && !Overrides<Isect, BoxRay, Boxes8>) {
            // The empty children come last in every order.
            top += pack_ordered(spans.near, spans.leaves, node.child, node.valid(), node.order,
                                order, nears + top, children + top);
        } else if constexpr (Query::ordered) {
            top += pack_ordered(spans.near, node.child, spans.mask, node.order, order, nears + top,
                                children + top);
        } else {
            top += pack_words(node.child, spans.mask, children + top);
        }
    };
    const auto go_to = [&](std::uint32_t next) RAYNEST_INLINE_LAMBDA {
        if constexpr (guessing) {
            child = guesses->check(child, next);
        } else {
            child = next;
        }
    };
    /// Takes the next child from the stack; false at its end. Entries behind the best hit are
    /// skipped; near == best may still win a tie.
    const auto pop = [&]() RAYNEST_INLINE_LAMBDA {
        do {
            if (--top == 0) return false;
        } while (Query::ordered && nears[top] > ray.tmax);
        go_to(children[top]);
        return true;
    };
    /// Goes down from a node to the next leaf; false if there is none.
    const auto find_leaf = [&]() RAYNEST_INLINE_LAMBDA {
        const NodeTest plain(ray);
        const auto test = [&](const Node& node) RAYNEST_INLINE_LAMBDA {
            if constexpr (Overrides<Isect, BoxRay, Boxes8>) {
                return intersect_with(isect, ray, Boxes8{&node});
            } else {
                return plain(node);
            }
        };
        /// Pushes the children of nodes, of which all but the last one waited on top.
        const auto look_at = [&](const auto&... nodes) RAYNEST_INLINE_LAMBDA {
            top -= static_cast<std::uint32_t>(sizeof...(nodes)) - 1;
            const std::tuple all_spans{test(nodes)...};
            std::apply([&](const auto&... spans)
                           RAYNEST_INLINE_LAMBDA { (push(nodes, spans), ...); },
                       all_spans);
        };
        do {
            const Node& node = arrays.node(child);
            if (!guessing && waits(1)) {
                if (nodes_together > 2 && waits(2)) {
                    look_at(waiting(2), waiting(1), node);
                } else {
                    look_at(waiting(1), node);
                }
            } else {
                // The next child need not come through the stack (measured, any hits: 1.02): the
                // first of those in no order, and an only one, as most nodes near the leaves have,
                // of others.
                const auto spans = test(node);
                const int lane = static_cast<int>(lowest_bit(spans.mask));
                if constexpr (Query::ordered) {
                    if (std::has_single_bit(spans.mask)) {
                        go_to(node.child[lane]);
                        continue;
                    }
                    if (spans.mask != 0) {
                        push(node, spans);
                        go_to(children[--top]);
                        continue;
                    }
                } else if (spans.mask != 0) {
                    go_to(node.child[lane]);
                    top += pack_words(node.child, spans.mask & (spans.mask - 1), children + top);
                    continue;
                }
            }
            if (!pop()) return false;
        } while (!is_leaf(child));
        return true;
    };

    for (;;) {
        if (!is_leaf(child) && !find_leaf()) return false;
        switch (kind_of(child)) {
            case ChildKind::triangles: {
                const TriangleBlock* block = arrays.blocks(child);
                const TriangleBlock* const end = block + leaf_count(child);
                bool first = true;
                for (; block != end; ++block, first = false) {
                    if (visit(ray, Triangles8{block, first}, isect, query)) return true;
                }
                break;
            }
            case ChildKind::instance:
                if (object.instance_count >= many_instances) {
                    ask_for_instance(1);
                    ask_for_instance(2);
                }
                if (visit(ray, Instance{&scene, object.first_instance + leaf_instance(child)},
                          isect, query)) {
                    return true;
                }
                break;
            case ChildKind::records:
                if (visit_record_type(
                        scene, object, leaf_first(child), leaf_count(child),
                        [&](const auto& record) { return visit(ray, record, isect, query); })) {
                    return true;
                }
                break;
        }
        if (!pop()) return false;
    }
}

/// A BVH inside another: the recursion is the only call that is not inlined.
template <class Isect, class Query>
[[gnu::noinline]] bool visit_tree(BoxRay& ray, const Bvh& bvh, Isect& isect, Query& query) {
    return traverse(ray, bvh, isect, query);
}

/// A BVH as an element of a list.
template <class R, class Isect, class Query>
bool visit(R& ray, const Bvh& bvh, Isect& isect, Query& query) {
    RayView inner = ray;
    inner.scene = bvh.scene;
    inner.object = &bvh.record();
    BoxRay boxed(inner);
    const bool done = visit_tree(boxed, bvh, isect, query);
    ray.tmax = boxed.tmax;
    return done;
}

}  // namespace raynest
