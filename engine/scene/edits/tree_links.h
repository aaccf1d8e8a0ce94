// The way up in an object's tree, from an instance to the root.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>
#include <vector>

namespace raynest {

/// Stays the same while a tree is refitted.
struct TreeLinks {
    std::vector<std::uint32_t> parents;  ///< of each node; no_id of the root
    std::vector<std::uint32_t>
        holders;  ///< the node that has each instance as a leaf; no_id: none has
};

/// In linear time.
TreeLinks links_of(const SceneView& view, const ObjectRecord& object);

}  // namespace raynest
