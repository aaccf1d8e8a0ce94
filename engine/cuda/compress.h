// Converts a snapshot's trees to those that a GPU reads (cuda/device_tree.h): same topology, same
// numbers.
#pragma once

#include "engine/cuda/device_tree.h"
#include "engine/geometry/triangle.h"
#include "engine/geometry/views.h"
#include "engine/result.h"

#include <span>
#include <vector>

namespace raynest::cuda {

struct DeviceTrees {
    std::vector<CompressedNode> nodes;
    std::vector<DeviceTriangle> triangles;

    [[nodiscard]] CompressedTrees view() const { return {nodes.data(), triangles.data()}; }
};

/// Converts a valid scene (scene/checks/arena_check.h). Fails with limit_exceeded if a ray could need more
/// levels or stack than the traversal has; only the CPU can trace such a scene. Linear time.
Result<DeviceTrees> compress(const SceneView& scene);

/// The same of some nodes or leaf blocks.
std::vector<CompressedNode> compress(std::span<const Node> nodes);
std::vector<DeviceTriangle> compress(std::span<const TriangleBlock> blocks);

/// Compresses a node. Every decoded box contains the true one. An axis whose bounds fit no grid has
/// no limits.
CompressedNode compress(const Node& node);

}  // namespace raynest::cuda
