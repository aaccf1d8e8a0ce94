#include "server/backends/cuda/scene_cache.h"

#include <algorithm>

namespace raynest::server::device {

DeviceSceneCache::Residence DeviceSceneCache::find_locked(std::string_view hash) {
    return std::find_if(scenes_.begin(), scenes_.end(),
                        [&](const Resident& resident) { return resident.hash == hash; });
}

DeviceSceneCache::Use DeviceSceneCache::find(std::string_view hash) {
    const std::lock_guard lock(mutex_);
    const Residence found = find_locked(hash);
    if (found == scenes_.end()) return {};
    scenes_.splice(scenes_.end(), scenes_, found);
    ++found->users;
    return {this, found};
}

DeviceSceneCache::Use::~Use() {
    if (owner_ == nullptr) return;
    const std::lock_guard lock(owner_->mutex_);
    --resident_->users;
}

bool DeviceSceneCache::evict_one() {
    std::list<Resident> evicted;
    {
        const std::lock_guard lock(mutex_);
        const auto idle =
            std::find_if(scenes_.begin(), scenes_.end(),
                         [](const Resident& resident) { return resident.users == 0; });
        if (idle == scenes_.end()) return false;
        evicted.splice(evicted.end(), scenes_, idle);
    }
    device_.unload(evicted.front().scene);
    return true;
}

template <class Make>
TraceStatus DeviceSceneCache::add(std::string_view hash, Make make) {
    if (find(hash).scene() != nullptr) return trace_ok;
    std::list<Resident> loaded(1);
    Resident& resident = loaded.front();
    resident.hash = hash;
    // Load without the lock, so that calls of other scenes go on: a large scene takes seconds.
    TraceStatus status = make(&resident.scene);
    while (status == trace_out_of_memory && evict_one()) status = make(&resident.scene);
    if (status != trace_ok) return status;
    while (device_.scene_bytes() > bytes_max_ && evict_one()) {
    }
    const std::lock_guard lock(mutex_);
    scenes_.splice(scenes_.end(), loaded);
    return trace_ok;
}

TraceStatus DeviceSceneCache::load(std::string_view hash, const SceneView& scene) {
    return add(hash, [&](DeviceScene** to) { return device_.load(&scene, to); });
}

TraceStatus DeviceSceneCache::load_changed(std::string_view hash, const DeviceScene& base,
                                           std::span<const ChangedRange> changes) {
    return add(hash, [&](DeviceScene** to) {
        return device_.load_changed(&base, changes.data(),
                                    static_cast<std::uint32_t>(changes.size()), to);
    });
}

}  // namespace raynest::server::device
