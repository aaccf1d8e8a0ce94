// A scene in a GPU's memory: the parts of a snapshot that kernels read, and its compressed trees.
#pragma once

#include "engine/cuda/device_memory.h"
#include "engine/cuda/device_tree.h"
#include "engine/geometry/views.h"
#include "engine/packs/abi.h"

#include <memory>

namespace raynest {

/// A scene on the device; all pointers are device pointers.
struct DeviceScene {
    cuda::DeviceMemory memory;
    const SceneView* view = nullptr;
    cuda::CompressedTrees trees{};
};

namespace cuda {

/// Copies a scene. trace_too_deep if kernels do not support it (cuda/compress.h). Throws
/// std::bad_alloc.
TraceStatus copy_to_device(const SceneView& scene, std::unique_ptr<DeviceScene>& loaded);

}  // namespace cuda
}  // namespace raynest
