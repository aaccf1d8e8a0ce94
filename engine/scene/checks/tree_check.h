// Checks the tree of one object, see arena_check.h.
#pragma once

#include "engine/geometry/views.h"
#include "engine/result.h"

#include <cstdint>
#include <vector>

namespace raynest {

/// Reused from object to object, so that a scene of many small objects allocates once.
class TreeChecker {
public:
    /// Every node, block, record and instance that the child words name lies within the object and
    /// is named at most once, all but instances exactly once; no path is longer than
    /// tree_height_max; blocks name triangles of the object, and padding lanes cannot be hit. The
    /// object's ranges must have been checked.
    Result<void> check(const SceneView& scene, const ObjectRecord& object);

private:
    Result<void> check_node(const Node& node, std::uint32_t index);
    Result<void> check_leaf(std::uint32_t leaf);
    Result<void> check_blocks(const TriangleBlock* blocks) const;

    const ObjectRecord* object_ = nullptr;
    std::vector<std::uint8_t> node_height_;  ///< 0: no parent seen yet
    std::vector<bool> block_seen_;
    std::vector<bool> record_seen_;
    std::vector<bool> instance_seen_;
};

}  // namespace raynest
