// The scenes in a device's memory; lives in the worker process. A scene stays until room is needed,
// even if the daemon unloaded it; the least recently used one is evicted first.
#pragma once

#include "engine/packs/device.h"

#include <cstdint>
#include <list>
#include <mutex>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server::device {

/// Thread-safe, except that only one thread at a time may load.
class DeviceSceneCache {
public:
    /// Evicts unused scenes beyond `bytes_max`, even if the device has room for more.
    DeviceSceneCache(const Device& device, std::uint64_t bytes_max)
        : device_(device),
          bytes_max_(bytes_max) {}
    DeviceSceneCache(const DeviceSceneCache&) = delete;

    class Use;
    /// Returns an empty Use if the device does not hold the scene.
    [[nodiscard]] Use find(std::string_view hash);
    /// Copies a scene to the device if it is not there. Evicts scenes that are not in use if the
    /// room is needed.
    TraceStatus load(std::string_view hash, const SceneView& scene);
    /// The same for a scene that an edit made of `base`, which is in use: only the changes are
    /// copied to the device.
    TraceStatus load_changed(std::string_view hash, const DeviceScene& base,
                             std::span<const ChangedRange> changes);
    /// Evicts the least recently used scene that is not in use; false if there is none.
    bool evict_one();

private:
    struct Resident {
        std::string hash;
        DeviceScene* scene = nullptr;
        unsigned users = 0;
    };
    using Residence = std::list<Resident>::iterator;

    Residence find_locked(std::string_view hash);
    /// Adds the scene that `make(to)` makes on the device.
    template <class Make>
    TraceStatus add(std::string_view hash, Make make);

    const Device& device_;
    const std::uint64_t bytes_max_;
    std::mutex mutex_;
    std::list<Resident> scenes_;  ///< least recently used first

public:
    /// Keeps a scene on the device while it exists. Move-only.
    class Use {
    public:
        Use() = default;
        Use(Use&& other) noexcept
            : owner_(std::exchange(other.owner_, nullptr)),
              resident_(other.resident_) {}
        Use& operator=(Use&&) = delete;
        Use(const Use&) = delete;
        ~Use();
        /// Null if empty.
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
