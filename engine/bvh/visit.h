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
#include "engine/bvh/node.h"
#include "engine/bvh/tree_arrays.h"
#include "engine/geometry/intersect_triangle.h"
#include "engine/geometry/record.h"
#include "engine/geometry/record_types.h"
#include "engine/geometry/views.h"
#include "engine/math/compact.h"

#include <bit>
#include <cstdint>
#include <utility>

namespace raynest {

/// One object of a scene as a primitive: the tree over its triangles, records and instances.
struct Bvh {
    const SceneView* scene;
    std::uint32_t object;

    [[nodiscard]] const ObjectRecord& record() const { return scene->objects[object]; }
    /// Leaf placements below: the step of path ids from one element of a list to the next.
    [[nodiscard]] std::uint64_t leaves() const { return record().leaves; }
};

/// One placement of an object, by its index in the scene's instances.
struct Instance {
    using instance_tag = void;
    const SceneView* scene;
    std::uint32_t index;

    [[nodiscard]] const InstanceRecord& record() const { return scene->instances[index]; }
    [[nodiscard]] std::uint64_t leaves() const { return scene->objects[record().object].leaves; }
};

/// Drops back faces of single-sided materials: `--set cull=back` (CONTRACT.md §1).
template <class H>
[[gnu::noinline]] void drop_back_faces(const RayView& ray, H& hits) {
    hits.keep_if([&](const Surface& surface) {
        if (surface.front) return true;
        if (ray.object == nullptr || ray.object->triangle_count == 0) return false;
        const GeometryRecord& geometry = ray.scene->geometry_of(*ray.object, surface.prim);
        return geometry.material != no_id &&
               ray.scene->materials[geometry.material].double_sided != 0;
    });
}

/// A primitive: the one place where surfaces are tested.
template <class R, PrimitiveLike P, class Isect, class Query>
RAYNEST_INLINE bool visit(R& ray, const P& primitive, Isect& isect, Query& query) {
    auto hits = ask(isect, ray, primitive);
    if (hits.mask == 0) [[likely]]
        return false;
    if (ray.flags != 0) [[unlikely]] {
        if constexpr (Query::ordered) {
            drop_back_faces(ray, hits);
        } else {
            // A copy, so that hits of which only the mask is read stay in registers, unfinished
            // (measured: 2 %; where all of them is read it costs 1).
            auto kept = hits;
            drop_back_faces(ray, kept);
            hits.mask = kept.mask;
        }
    }
    return query.take(ray, hits);
}

template <class Isect, class Query>
bool visit_tree(BoxRay& ray, const Bvh& bvh, Isect& isect, Query& query);

/// The ray as the instance's object sees it: same t, one level down.
[[nodiscard]] RAYNEST_INLINE RayView enter(const RayView& ray, const SceneView& scene,
                                           const InstanceRecord& instance) {
    // Member by member: a copied block would wait for the stores that it was written with.
    return {instance.to_object.point(ray.origin),
            instance.to_object.direction(ray.direction),
            ray.tmin,
            ray.tmax,
            ray.world,
            &scene,
            &scene.objects[instance.object],
            ray.path + instance.path_base,
            ray.id,
            ray.mask,
            ray.flags};
}

template <class R, class Isect, class Query>
RAYNEST_INLINE bool visit(R& ray, const Instance& instance, Isect& isect, Query& query) {
    const InstanceRecord& record = instance.record();
    if ((record.mask & ray.mask) == 0) return false;
    if (!enters(isect, ray, instance)) return false;
    BoxRay inner(enter(ray, *instance.scene, record));
    const bool done = visit_tree(inner, Bvh{instance.scene, record.object}, isect, query);
    ray.tmax = inner.tmax;
    return done;
}

/// Calls `with(const P*)` for the primitive type of the object's records.
template <class Visitor>
RAYNEST_INLINE bool visit_record_type(const SceneView& scene, const ObjectRecord& object,
                                      std::uint32_t first, std::uint32_t count, Visitor&& visitor) {
    bool done = false;
    for_each_record_type([&]<class P>(RecordType<P> type) {
        if (object.record_type != type.id || done) return;
        constexpr std::size_t stride = sizeof(P) + sizeof(std::uint32_t);
        const std::byte* at = scene.records + object.first_record + stride * first;
        for (std::uint32_t i = 0; i < count && !done; ++i, at += stride) {
            std::uint32_t index;
            __builtin_memcpy(&index, at + sizeof(P), sizeof index);
            done = visitor(Record<P>{reinterpret_cast<const P*>(at), index, i == 0});
        }
    });
    return done;
}

/// Shift of Node::order that sorts a node's children for the ray, farthest first.
[[nodiscard]] RAYNEST_INLINE std::uint32_t far_first(const BoxRay& ray) {
    const auto& rows = ray.slabs.near_row;
    return 3 * ((rows[0] | rows[1] << 1 | rows[2] << 2) ^ 7U);
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
