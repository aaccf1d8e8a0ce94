// A device pack at its second door (packs/device.h), with scenes and slots that free themselves.
//
// A benchmark goes on only where all goes well: what fails throws std::runtime_error.
#pragma once

#include "engine/packs/load.h"

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

namespace raynest::bench {

/// None can be opened.
struct NoDevice : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// The first door of any pack, of this tree's ABI and for this machine's CPU.
const Pack& open_pack(const std::string& path);
/// null where it has none of that name.
const PackVariant* find_variant(const Pack& pack, const std::string& name);

/// Opens the first device; stays loaded.
class OpenDevice {
public:
    explicit OpenDevice(const std::string& path);
    [[nodiscard]] const Pack& pack() const { return *doors_.pack; }
    [[nodiscard]] const DeviceInfo& info() const { return info_; }

    using Scene = std::unique_ptr<DeviceScene, void (*)(DeviceScene*) noexcept>;
    using Slot = std::unique_ptr<DeviceSlot, void (*)(DeviceSlot*) noexcept>;
    [[nodiscard]] Scene load(const SceneView& view) const;
    [[nodiscard]] Slot make_slot(std::uint64_t rays, std::uint64_t hits) const;
    /// Gives why it was refused, or nothing: without it copies are slower, and right.
    [[nodiscard]] std::string pin(void* memory, std::uint64_t bytes) const;

    /// With `made` the device makes the call's rays.
    void start(const Slot& slot, const Scene& scene, TraceFunction kernel, const TraceCall& call,
               const PinholeRays* made) const;
    /// Gives the seconds that its kernel took.
    double finish(const Slot& slot) const;

private:
    void expect_ok(TraceStatus status, const std::string& step) const;

    DevicePack doors_;
    DeviceInfo info_{};
};

}  // namespace raynest::bench
