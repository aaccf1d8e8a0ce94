// Memory on a GPU for the rays and answers of one call, and the stream that copies them.
#pragma once

#include "engine/cuda/device_memory.h"
#include "engine/geometry/hit.h"
#include "engine/geometry/pinhole.h"
#include "engine/packs/device.h"

#include <cstdint>
#include <memory>

namespace raynest {

struct DeviceSlot {
    DeviceSlot() = default;
    DeviceSlot(const DeviceSlot&) = delete;
    DeviceSlot& operator=(const DeviceSlot&) = delete;
    ~DeviceSlot() {
        for (const cudaEvent_t event : {kernel_begin, kernel_end}) {
            if (event != nullptr) cudaEventDestroy(event);
        }
        if (stream != nullptr) cudaStreamDestroy(stream);
    }

    cudaStream_t stream = nullptr;
    cudaEvent_t kernel_begin = nullptr;
    cudaEvent_t kernel_end = nullptr;
    cuda::DeviceMemory memory;
    std::uint64_t rays_max = 0;
    std::uint64_t hits_max = 0;
    Ray* rays = nullptr;
    HitRecord* hits = nullptr;
    std::uint32_t* hit_counts = nullptr;
};

namespace cuda {

/// Allocates a slot. Throws std::bad_alloc.
TraceStatus make_slot(std::uint64_t rays_max, std::uint64_t hits_max,
                      std::unique_ptr<DeviceSlot>& made);

/// The object behind TraceCall::device: the slot and the scene of a call.
struct Target {
    DeviceSlot& slot;
    const DeviceScene& scene;
    const PinholeRays* made;  ///< null if the call brings its rays
};

}  // namespace cuda
}  // namespace raynest
