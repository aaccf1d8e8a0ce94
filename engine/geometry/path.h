// The way down a flat path id: which instance of which object, level by level.
//
//   leaves(object) = (own primitives ? 1 : 0) + sum of leaves(child) over its instances
//   path           = sum of path_base over the instances on the way down
#pragma once

#include "engine/geometry/views.h"

#include <algorithm>
#include <cstdint>

namespace raynest {

/// Calls visit(index in SceneView::instances) for each instance on the way to leaf placement
/// `path`, outermost first; not at all where the root's own primitives are meant. Returns the
/// object that holds the placement's primitives, or null when the scene has no such path. O(levels
/// * log n).
template <class Visit>
const ObjectRecord* walk_path(const SceneView& scene, std::uint64_t path, Visit&& visit) {
    const ObjectRecord* object = &scene.objects[scene.root];
    if (path >= object->leaves) return nullptr;

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
