// The brute-force reference: every primitive of every placement, no tree, no box.
//
// It walks the same chain of transforms and asks the same intersector about the same primitives,
// one lane at a time, in the same pack; the difference to any traversal is 0. It
// shares visit() of a single primitive with the traversal and nothing of the tree.
#pragma once

#include "engine/bvh/cancellation.h"
#include "engine/bvh/visit_primitive.h"

namespace raynest {

/// The work that it does between two questions, as Cancellation counts: eight triangles one by one
/// take as long as four blocks; an object may be empty, and its instances still take time.
inline constexpr std::int64_t reference_block_work = 4;
inline constexpr std::int64_t reference_record_work = 1;
inline constexpr std::int64_t reference_instance_work = 64;

template <class Isect, class Query>
bool brute_force(RayView& ray, const Bvh& bvh, Isect& isect, Query& query) {
    const SceneView& scene = *bvh.scene;
    const ObjectRecord& object = bvh.record();
    const TriangleBlock* blocks = scene.blocks + object.first_block;
    for (std::uint32_t b = 0; b < object.block_count; ++b) {
        if (is_cancelled(query.cancellation, reference_block_work)) return true;
        for (int lane = 0; lane < 8; ++lane) {
            if (blocks[b].triangle[lane] == no_id) continue;
            if (visit(ray, TriangleRef(blocks[b], lane), isect, query)) return true;
        }
    }
    if (object.record_count != 0 &&
        visit_record_type(scene, object, 0, object.record_count, [&](const auto& record) {
            return is_cancelled(query.cancellation, reference_record_work) ||
                   visit(ray, record, isect, query);
        })) {
        return true;
    }
    for (std::uint32_t i = 0; i < object.instance_count; ++i) {
        if (is_cancelled(query.cancellation, reference_instance_work)) return true;
        const Instance instance{&scene, object.first_instance + i};
        if ((instance.record().mask & ray.mask) == 0) continue;
        if (!enters(isect, ray, instance)) continue;
        RayView inner = enter(ray, scene, instance.record());
        const bool done = brute_force(inner, Bvh{&scene, instance.record().object}, isect, query);
        ray.tmax = inner.tmax;
        if (done) return true;
    }
    return false;
}

}  // namespace raynest
