// The scenes that a device holds, in the worker's process. They stay until room is needed, unloaded
// or not; then the least recently used goes first.
#pragma once

#include "engine/packs/device.h"

#include <cstdint>
#include <list>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server::device {

/// Thread-safe, but for loads among themselves.
class DeviceSceneCache {
public:
    /// Beyond `bytes_max` what is not in use goes, even where the device has room.
    DeviceSceneCache(const Device& device, std::uint64_t bytes_max)
        : device_(device),
          bytes_max_(bytes_max) {}
    DeviceSceneCache(const DeviceSceneCache&) = delete;

    class Use;
    /// Empty where the scene is not there.
    [[nodiscard]] Use find(std::string_view hash);
    /// Copies a scene to the device, unless it is there; makes room as far as scenes that are not
    /// in use give it.
    TraceStatus load(std::string_view hash, const SceneView& scene);
    /// The least recently used goes; false when all are in use.
    bool evict_one();

private:
    struct Resident {
        std::string hash;
        DeviceScene* scene = nullptr;
        std::uint64_t bytes = 0;
        unsigned users = 0;
    };
    using Residence = std::list<Resident>::iterator;

    Residence find_locked(std::string_view hash);
    bool would_exceed(std::uint64_t bytes);

    const Device& device_;
    const std::uint64_t bytes_max_;
    std::mutex mutex_;
    std::list<Resident> scenes_;  ///< last used last
    std::uint64_t bytes_ = 0;

public:
    /// While it lives, the scene stays. Move-only.
    class Use {
    public:
        Use() = default;
        Use(Use&& other) noexcept
            : owner_(std::exchange(other.owner_, nullptr)),
              resident_(other.resident_) {}
        Use& operator=(Use&&) = delete;
        Use(const Use&) = delete;
        ~Use();
        /// null when empty.
        [[nodiscard]] const DeviceScene* scene() const {
            return owner_ == nullptr ? nullptr : resident_->scene;
        }

    private:
        friend class DeviceSceneCache;
        Use(DeviceSceneCache* owner, Residence resident) : owner_(owner), resident_(resident) {}
        DeviceSceneCache* owner_ = nullptr;
        Residence resident_{};
    };
};

}  // namespace raynest::server::device
