// Traversal for a GPU: one ray through all levels of a scene, with one explicit stack.
//
// A GPU has no cheap recursion (nvcc compiles real calls, with spills at each level) and needs few
// registers, so nesting is data. Entering an instance pushes the waiting children and a mark, and
// saves the parent's ray. Popping the mark restores that ray, with the best distance so far. The
// saved ray has the bits that were computed on the way down; transforming back would not reproduce
// them.
//
// `Trees` is CompressedTrees, or in tests a plain version of it with binary nodes. Trees::stack_max
// is the size of the stack.
//
// On an H200 every intersector, query and depth gives the CPU's bytes (tests/bench/BENCH.md);
// without a GPU, g++ compiles this too and tests loop it over rays (tests/cuda). Registers and
// frames: tests/cuda/registers.txt. Bounds of 80 and 64 registers make flat scenes up to 1.16 times
// as fast and instanced ones down to 0.66. Not tried: the top of the stack in shared memory, slabs
// in the node's own grid (one fma per plane).
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/bvh/node.h"
#include "engine/bvh/visit_primitive.h"
#include "engine/cuda/limits.h"
#include "engine/geometry/box_ray.h"
#include "engine/math/mask.h"

#include <cstdint>

namespace raynest::cuda {

/// Waiting children of a node: bit k is the k-th that the ray meets.
struct Waiting {
    std::uint32_t node;
    std::uint32_t children;
};
/// Marks a stack entry as an instance to leave; larger than any mask of children.
inline constexpr std::uint32_t leave_instance = 0xFFFFFFFFU;

/// The ray's state at the level that it returns to.
struct Level {
    Vec3 origin, direction;
    const ObjectRecord* object;
    std::uint64_t path;
};

/// Answers `query` for a ray at the root of its scene. Returns false, without an answer, after
/// ray_steps_max steps.
template <class Trees, class Isect, class Query>
[[nodiscard]] RAYNEST_INLINE bool traverse_levels(const RayView& outermost, const Trees& trees,
                                                  Isect& isect, Query& query) {
    const SceneView& scene = *outermost.scene;
    Waiting stack[Trees::stack_max];
    std::uint32_t top = 0;
    Level parents[levels_max - 1];
    std::uint32_t depth = 0;

    BoxRay ray(outermost);
    auto tree = trees.of(*ray.object);
    const auto look_from = [&](const RayView& view) RAYNEST_INLINE_LAMBDA {
        ray = BoxRay(view);
        tree = trees.of(*ray.object);
    };

    Waiting waiting{0, 0};
    std::uint32_t child = ray.object->root;
    for (std::uint32_t steps = 0; steps < ray_steps_max; ++steps) {
        if (child == child_empty) {
            // The object is empty.
        } else if (!is_leaf(child)) {
            if (waiting.children != 0) stack[top++] = waiting;
            waiting = {child, tree.entered(child, ray, isect)};
        } else if (kind_of(child) == ChildKind::triangles) {
            const auto visitor = [&](const auto& triangle) RAYNEST_INLINE_LAMBDA {
                ++steps;
                return visit(ray, triangle, isect, query);
            };
            if (tree.visit_triangles(child, visitor)) return true;
        } else if (kind_of(child) == ChildKind::records) {
            const auto visitor = [&](const auto& record) RAYNEST_INLINE_LAMBDA {
                ++steps;
                return visit(ray, record, isect, query);
            };
            if (visit_record_type(scene, *ray.object, leaf_first(child), leaf_count(child),
                                  visitor)) {
                return true;
            }
        } else {
            const Instance instance{&scene, ray.object->first_instance + leaf_instance(child)};
            const InstanceRecord& record = instance.record();
            if ((record.mask & ray.mask) != 0 && enters(isect, ray, instance)) {
                if (waiting.children != 0) stack[top++] = waiting;
                stack[top++] = {0, leave_instance};
                waiting.children = 0;
                parents[depth++] = {ray.origin, ray.direction, ray.object, ray.path};
                look_from(enter(ray, scene, record));
                child = ray.object->root;
                continue;
            }
        }

        while (waiting.children == 0) {
            if (top == 0) return true;
            waiting = stack[--top];
            if (waiting.children != leave_instance) continue;
            waiting.children = 0;
            const Level& parent = parents[--depth];
            RayView view = ray;
            view.origin = parent.origin;
            view.direction = parent.direction;
            view.object = parent.object;
            view.path = parent.path;
            look_from(view);
        }
        const auto nearest = lowest_bit(waiting.children);
        waiting.children &= waiting.children - 1;
        child = tree.child(waiting.node, nearest ^ ray.slabs.octant);
    }
    return false;
}

}  // namespace raynest::cuda
