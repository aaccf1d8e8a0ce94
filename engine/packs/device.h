// The second interface of a pack whose kernels run on a device with its own memory: C types only.
//
// Calls through the first interface (packs/abi.h) are independent and bring their scene. Here
// scenes stay on the device, and calls go through slots. A slot has memory for one call's rays and
// answers, and its own queue, so that one slot's copies run beside another's kernel.
//
// The caller must be prepared to lose the process: after a kernel error, nothing that the process
// has on the device may work any more (server/backends/cuda).
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/packs/abi.h"

#include <cstdint>

namespace raynest {

inline constexpr std::uint32_t device_abi = 3;

struct DeviceScene;  ///< defined by the pack
struct DeviceSlot;   ///< defined by the pack

struct DeviceInfo {
    char name[128];
    std::uint64_t memory_bytes;
    bool absent;  ///< open() failed for good: there is no device that the pack supports
};

/// The arrays of a SceneView that a device holds.
enum SceneArray : std::uint32_t {
    array_nodes,
    array_blocks,
    array_records,
    array_objects,
    array_instances,
    array_geometries,
    array_materials,
    array_textures,
    array_attributes,
    array_count
};

/// Elements of an array, which a scene has in place of those of another; bytes of records and
/// attributes.
struct ChangedRange {
    std::uint32_t array;  ///< SceneArray
    std::uint64_t first;
    std::uint64_t count;
    const void* elements;  ///< aligned as in an arena
};

/// All functions are thread-safe, except that calls on one slot must not overlap. trace_no_device
/// means that nothing on this device can be trusted any more; error() says why.
struct Device {
    std::uint32_t abi;  ///< device_abi
    /// Takes the first device that the system shows.
    TraceStatus (*open)(DeviceInfo*) noexcept;
    /// The error text of the device's runtime for this thread's last failed call.
    const char* (*error)() noexcept;
    /// Registers memory that calls will read and write, so that the device copies without the CPU.
    /// Lasts for the life of the process.
    TraceStatus (*pin)(void* memory, std::uint64_t bytes) noexcept;

    /// Copies a checked scene (scene/checks/arena_check.h) to the device; the original may then go.
    /// trace_too_deep: the scene has more levels than kernels support. trace_out_of_memory: the
    /// device is full; trace_cancelled: the host is.
    TraceStatus (*load)(const SceneView*, DeviceScene**) noexcept;
    /// Makes the scene that an edit made of `base` (scene/edits/edit.h): it has these elements and
    /// is otherwise the same, so that nothing else is copied from the host. Both may then go in any
    /// order. trace_bad_call: `base` has no such elements. What they hold is not checked. Else
    /// returns what load() does.
    TraceStatus (*load_changed)(const DeviceScene* base, const ChangedRange*, std::uint32_t count,
                                DeviceScene**) noexcept;
    void (*unload)(DeviceScene*) noexcept;
    /// Bytes that were copied from the host to make the scene.
    std::uint64_t (*copied_bytes)(const DeviceScene*) noexcept;
    /// Bytes of all scenes on the device. What several share counts once.
    std::uint64_t (*scene_bytes)() noexcept;

    /// Makes a slot for calls with at most so many rays and hits.
    TraceStatus (*make_slot)(std::uint64_t rays_max, std::uint64_t hits_max, DeviceSlot**) noexcept;
    void (*free_slot)(DeviceSlot*) noexcept;
    /// Queues a call: copies in, kernel, copies out. `kernel` is from the pack's own table. The
    /// call's scene is ignored; its rays and answers lie in pinned memory, and must stay untouched
    /// until finish(). With `made` the device makes the rays itself, and the call has none.
    TraceStatus (*start)(DeviceSlot*, const DeviceScene*, TraceFunction kernel, const TraceCall*,
                         const PinholeRays* made) noexcept;
    /// Waits for the slot's call.
    TraceStatus (*finish)(DeviceSlot*) noexcept;
    /// Returns the kernel time of the slot's last finished call, by the device's clock.
    TraceStatus (*kernel_seconds)(const DeviceSlot*, double* seconds) noexcept;
};

inline constexpr const char* device_symbol = "raynest_device";
using DeviceEntry = const Device* (*)() noexcept;

}  // namespace raynest
