// Whatever can be hit is visited: a triangle, a record, a BVH, an instance of a BVH.
//
// One overload set; each hands the intersector and the query on, so nesting has no special case and
// no fixed depth. `query.take(ray, hits)` keeps what it wants, shrinks ray.tmax and returns true
// when the whole query is answered; every visit passes that on.
//
// This is the latency traversal: one ray, near children first, a stack of (child, near) per level
// and recursion between levels (measured: no slower than one explicit stack; notes of the traversal
// prototypes). Depth is bounded by scene_depth_max, the stack by tree_height_max; both are checked
// when a scene is made, not here.
#pragma once

#include "engine/bvh/ask.h"
#include "engine/bvh/box_test.h"
#include "engine/bvh/cancellation.h"
#include "engine/bvh/node.h"
#include "engine/bvh/tree_arrays.h"
#include "engine/bvh/visit_primitive.h"
#include "engine/math/compact.h"

#include <bit>
#include <cstdint>
#include <utility>

namespace raynest {

template <class Isect, class Query>
bool visit_tree(BoxRay& ray, const Bvh& bvh, Isect& isect, Query& query);

template <class R, class Isect, class Query>
RAYNEST_INLINE bool visit(R& ray, const Instance& instance, Isect& isect, Query& query) {
    const InstanceRecord& record = instance.record();
    if ((record.mask & ray.mask) == 0) return false;
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

/// The latency traversal of one tree.
template <class Isect, class Query>
RAYNEST_INLINE bool traverse(BoxRay& ray, const Bvh& bvh, Isect& isect, Query& query) {
    const SceneView& scene = *bvh.scene;
    const ObjectRecord& object = scene.objects[bvh.object];
    // Of the children that wait, the one to be popped next is asked for while the nearest is looked
    // at (measured: 5 % on closest hits, 10 on random rays, 2 on any hits; two cost what they
    // gain).
    const TreeArrays arrays(scene, object);

    // Child words, and where the ray enters them; packing writes eight entries behind the top.
    std::uint32_t children[7 * tree_height_max + 8];
    float nears[7 * tree_height_max + 8];
    std::uint32_t top = 0;
    const std::uint32_t order = far_first(ray);
    std::uint32_t child = object.root;
    if (child == child_empty) return false;

    for (;;) {
        bool pop = false;
        while (!is_leaf(child)) {
            const Node& node = arrays.node(child);
            const auto spans = ask(isect, ray, Boxes8{&node});
            std::uint32_t mask = spans.mask;
            if (mask == 0) {
                pop = true;
                break;
            }
            const auto first = static_cast<std::uint32_t>(std::countr_zero(mask));
            mask &= mask - 1;
            if (mask == 0) {  // one child: most nodes near the leaves
                child = node.child[first];
                continue;
            }
            if constexpr (!Query::ordered) {
                // Any hit ends the search; looking for the nearest child first costs more than it
                // saves (measured: 4 % on ambient occlusion), and so does pushing one by one (6 %).
                child = node.child[first];
                top += pack_words(node.child, mask, children + top);
                arrays.prefetch(children[top - 1]);
                continue;
            }
            const auto second = static_cast<std::uint32_t>(std::countr_zero(mask));
            mask &= mask - 1;
            if (mask == 0) {
                alignas(32) float near[8];
                spans.near.store(near);
                const bool swap = near[second] < near[first];
                const std::uint32_t closer = swap ? second : first;
                const std::uint32_t farther = swap ? first : second;
                children[top] = node.child[farther];
                nears[top++] = near[farther];
                arrays.prefetch(node.child[farther]);
                child = node.child[closer];
                continue;
            }
            // Three and more: in the order of the ray's octant, without a branch. Sorting them by
            // distance visits 1 % fewer nodes and costs 7 % (mispredicted comparisons); doing the
            // same with two costs 5 %, because the stack must answer before the loop goes on.
            top += pack_ordered(spans.near, node.child, spans.mask, node.order, order, nears + top,
                                children + top);
            child = children[--top];
            arrays.prefetch(children[top - 1]);
        }

        if (!pop) {
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
        }

        // Entries behind the best hit are skipped; near == best may still win a tie.
        for (;;) {
            if (top == 0) return false;
            --top;
            if (!Query::ordered || nears[top] <= ray.tmax) break;
        }
        child = children[top];
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
