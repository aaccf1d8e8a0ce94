// The second door of a pack whose kernels run on a device with a memory of its own: C types only.
//
// At the first door (packs/abi.h) every call stands alone and carries its scene along. Here scenes
// stay on the device, and calls go through slots: room for one call's rays and answers, and a queue
// of its own, so that one slot's copies run beside another's kernel.
//
// Who uses it is prepared to lose the process: an error of a kernel may poison all that the process
// has on the device (server/device).
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/packs/abi.h"

#include <cstdint>

namespace raynest {

inline constexpr std::uint32_t device_abi = 2;

struct DeviceScene;  ///< the pack's
struct DeviceSlot;   ///< the pack's

struct DeviceInfo {
    char name[128];
    std::uint64_t memory_bytes;
    bool absent;  ///< open() failed from what lasts: there is no device that the pack has code for
};

/// All functions are thread-safe but for those of one slot among themselves. trace_no_device means
/// that nothing on this device can be trusted any more; error() says why.
struct Device {
    std::uint32_t abi;  ///< device_abi
    /// Takes the first device that the system shows.
    TraceStatus (*open)(DeviceInfo*) noexcept;
    /// What this thread's last call that failed failed from, as the device's runtime calls it.
    const char* (*error)() noexcept;
    /// Tells the device of memory that calls will read and write, so that it copies on its own. For
    /// the life of the process.
    TraceStatus (*pin)(void* memory, std::uint64_t bytes) noexcept;

    /// Copies a sound scene (scene/arena_check.h) to the device; it is not needed afterwards.
    /// trace_too_deep: it has more levels than kernels take. trace_out_of_memory: of the device;
    /// trace_cancelled: of the host.
    TraceStatus (*load)(const SceneView*, DeviceScene**) noexcept;
    void (*unload)(DeviceScene*) noexcept;
    std::uint64_t (*bytes_of)(const DeviceScene*) noexcept;

    /// Room for so many rays and hits of a call.
    TraceStatus (*make_slot)(std::uint64_t rays_max, std::uint64_t hits_max, DeviceSlot**) noexcept;
    void (*free_slot)(DeviceSlot*) noexcept;
    /// Queues a call: copies in, kernel, copies out. `kernel` is of the pack's own table. The
    /// call's scene is not looked at; its rays and answers are where pin() said, and stay untouched
    /// until finish(). With `made` the device makes the rays itself, and the call has none.
    TraceStatus (*start)(DeviceSlot*, const DeviceScene*, TraceFunction kernel, const TraceCall*,
                         const PinholeRays* made) noexcept;
    /// Waits for it.
    TraceStatus (*finish)(DeviceSlot*) noexcept;
    /// How long the kernel of the slot's last finished call took, by the device's clock.
    TraceStatus (*kernel_seconds)(const DeviceSlot*, double* seconds) noexcept;
};

inline constexpr const char* device_symbol = "raynest_device";
using DeviceEntry = const Device* (*)() noexcept;

}  // namespace raynest
