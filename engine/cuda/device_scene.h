// A scene in a GPU's memory: what kernels read of a snapshot, and its compressed trees.
#pragma once

#include "engine/cuda/device_memory.h"
#include "engine/cuda/device_tree.h"
#include "engine/geometry/views.h"
#include "engine/packs/abi.h"

#include <memory>

namespace raynest {

/// All pointers are the device's.
struct DeviceScene {
    cuda::DeviceMemory memory;
    const SceneView* view = nullptr;
    cuda::CompressedTrees trees{};
};

namespace cuda {

/// trace_too_deep where kernels do not take the scene (cuda/compress.h). Throws std::bad_alloc.
TraceStatus copy_to_device(const SceneView& scene, std::unique_ptr<DeviceScene>& loaded);

}  // namespace cuda
}  // namespace raynest
