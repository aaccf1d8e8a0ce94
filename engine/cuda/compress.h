// From a snapshot's trees to those that a GPU reads (cuda/device_tree.h): same topology, same
// numbers.
#pragma once

#include "engine/cuda/device_tree.h"
#include "engine/geometry/views.h"
#include "engine/result.h"

#include <vector>

namespace raynest::cuda {

struct DeviceTrees {
    std::vector<CompressedNode> nodes;
    std::vector<DeviceTriangle> triangles;

    [[nodiscard]] CompressedTrees view() const { return {nodes.data(), triangles.data()}; }
};

/// Fails with limit_exceeded where a ray could need more levels or stack than the traversal has:
/// the scene is the CPU's then. The scene is a sound one (scene/arena_check.h). Linear time.
Result<DeviceTrees> compress(const SceneView& scene);

/// Every decoded box contains the true one. An axis whose bounds fit no grid constrains nothing.
CompressedNode compress(const Node& node);

}  // namespace raynest::cuda
