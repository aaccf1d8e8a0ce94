// A device pack opened by its device entry point (packs/device.h), with scenes and slots that free
// themselves.
//
// Benchmarks stop at the first failure: every failure throws std::runtime_error.
#pragma once

#include "engine/packs/load.h"

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

namespace raynest::bench {

/// Thrown if no device can be opened.
struct NoDevice : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// Opens the first entry point of a pack with this tree's ABI, for this machine's CPU.
const Pack& open_pack(const std::string& path);
/// Returns the variant of that name, or null.
const PackVariant* find_variant(const Pack& pack, const std::string& name);

/// Opens the first device; the pack stays loaded.
class OpenDevice {
public:
    explicit OpenDevice(const std::string& path);
    [[nodiscard]] const Pack& pack() const { return *device_pack_.pack; }
    [[nodiscard]] const DeviceInfo& info() const { return info_; }

    using Scene = std::unique_ptr<DeviceScene, void (*)(DeviceScene*) noexcept>;
    using Slot = std::unique_ptr<DeviceSlot, void (*)(DeviceSlot*) noexcept>;
    [[nodiscard]] Scene load(const SceneView& view) const;
    [[nodiscard]] Slot make_slot(std::uint64_t rays, std::uint64_t hits) const;
    /// Pins memory. Returns the reason if that is refused, else nothing: copies are then slower but
    /// correct.
    [[nodiscard]] std::string pin(void* memory, std::uint64_t bytes) const;

    /// Starts a call. With `made` the device makes the call's rays.
    void start(const Slot& slot, const Scene& scene, TraceFunction kernel, const TraceCall& call,
               const PinholeRays* made) const;
    /// Waits for a call and returns the seconds that its kernel took.
    double finish(const Slot& slot) const;

private:
    void expect_ok(TraceStatus status, const std::string& step) const;

    DevicePack device_pack_;
    DeviceInfo info_{};
};

}  // namespace raynest::bench
