// The way down a flat path id: which instance of which object, level by level.
//
//   placement_count(object) = (own primitives ? 1 : 0) + sum of placement_count(child) over its instances
//   path           = sum of path_base over the instances on the way down
#pragma once

#include "engine/geometry/views.h"

#include <algorithm>
#include <cstdint>

namespace raynest {

/// A node of the tree that a scene was read from: one step of path texts.
struct PathNode {
    std::uint32_t parent;     ///< the node above; node 0 is the scene itself
    std::uint32_t name;       ///< offset in `names`, spelled as in path texts
    std::uint32_t number;     ///< first one of the node among siblings of its name; no_id: unique
    std::uint32_t source;     ///< index in the file
    std::uint32_t first_run;  ///< its own placements' first, or no_id
};

/// Consecutive paths that are placements of one node.
struct PathRun {
    std::uint64_t first_path;
    std::uint32_t node;
    std::uint32_t number;  ///< the first placement's; the others count on
};

/// How paths are named. A scene that was read from a tree of nodes keeps that tree, because equal
/// subtrees share their instances and still have names of their own. Any other scene is named by
/// its instances, and `numbers` tells apart those of one name in one object.
struct PathTable {
    const PathNode* nodes = nullptr;         ///< breadth first, so that siblings are neighbours
    const PathRun* runs = nullptr;           ///< in the order of paths, without gaps
    const std::uint32_t* numbers = nullptr;  ///< per instance, no_id: unique; null: all are
    std::uint64_t names_bytes = 0;           ///< bytes in SceneView::names
    std::uint32_t node_count = 0;            ///< 0: paths are named by instances
    std::uint32_t run_count = 0;

    /// The run of a path that exists; only where there are nodes.
    [[nodiscard]] const PathRun& run_of(std::uint64_t path) const {
        const PathRun* next = std::upper_bound(
            runs, runs + run_count, path,
            [](std::uint64_t p, const PathRun& run) { return p < run.first_path; });
        return *(next - 1);
    }
};

/// Calls visit(index in SceneView::instances) for each instance on the way to leaf placement
/// `path`, outermost first; not at all where the root's own primitives are meant. Returns the
/// object that holds the placement's primitives, or null when the scene has no such path. O(levels
/// * log n).
template <class Visit>
const ObjectRecord* walk_path(const SceneView& scene, std::uint64_t path, Visit&& visit) {
    const ObjectRecord* object = &scene.objects[scene.root];
    if (path >= object->placement_count) return nullptr;

    // Own primitives hold slot 0; of several instances with one base the last has the leaves.
    while (path != 0 || !object->has_own_primitives()) {
        const InstanceRecord* first = scene.instances + object->first_instance;
        const InstanceRecord* next = std::upper_bound(
            first, first + object->instance_count, path,
            [](std::uint64_t p, const InstanceRecord& instance) { return p < instance.path_base; });
        const InstanceRecord& instance = *(next - 1);
        visit(static_cast<std::uint32_t>(&instance - scene.instances));
        path -= instance.path_base;
        object = &scene.objects[instance.object];
    }
    return object;
}

}  // namespace raynest
