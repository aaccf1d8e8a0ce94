// A scene in a GPU's memory: the parts of a snapshot that kernels read, and its compressed trees.
#pragma once

#include "engine/cuda/device_tree.h"
#include "engine/geometry/views.h"
#include "engine/packs/abi.h"
#include "engine/packs/device.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

namespace raynest {
namespace cuda {

/// An array on the device. Scenes share those that no edit between them has changed.
struct DeviceArray {
    std::shared_ptr<std::byte> data;  ///< a device pointer; null where the array is empty
    std::uint64_t count = 0;          ///< elements
};

}  // namespace cuda

/// A scene on the device.
struct DeviceScene {
    std::array<cuda::DeviceArray, array_count> arrays;
    SceneView on_host;  ///< what `view` points to
    cuda::DeviceArray view_array;
    const SceneView* view = nullptr;  ///< on the device, as are the pointers in it
    cuda::CompressedTrees trees{};
    std::uint64_t copied_bytes = 0;  ///< from the host
};

namespace cuda {

/// Copies a scene. trace_too_deep if kernels do not support it (cuda/compress.h). Throws
/// std::bad_alloc.
TraceStatus copy_to_device(const SceneView& scene, std::unique_ptr<DeviceScene>& loaded);

/// Device::load_changed. Throws std::bad_alloc.
TraceStatus copy_changed(const DeviceScene& base, std::span<const ChangedRange> ranges,
                         std::unique_ptr<DeviceScene>& loaded);

/// Device::scene_bytes.
std::uint64_t scene_bytes() noexcept;

}  // namespace cuda
}  // namespace raynest
