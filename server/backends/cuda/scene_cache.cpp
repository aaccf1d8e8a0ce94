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
        bytes_ -= idle->bytes;
        evicted.splice(evicted.end(), scenes_, idle);
    }
    device_.unload(evicted.front().scene);
    return true;
}

TraceStatus DeviceSceneCache::load(std::string_view hash, const SceneView& scene) {
    if (find(hash).scene() != nullptr) return trace_ok;
    std::list<Resident> loaded(1);
    Resident& resident = loaded.front();
    resident.hash = hash;
    // Load without the lock, so that calls of other scenes go on: a large scene takes seconds.
    TraceStatus status = device_.load(&scene, &resident.scene);
    while (status == trace_out_of_memory && evict_one())
        status = device_.load(&scene, &resident.scene);
    if (status != trace_ok) return status;
    resident.bytes = device_.bytes_of(resident.scene);
    while (would_exceed(resident.bytes) && evict_one()) {
    }
    const std::lock_guard lock(mutex_);
    bytes_ += resident.bytes;
    scenes_.splice(scenes_.end(), loaded);
    return trace_ok;
}

bool DeviceSceneCache::would_exceed(std::uint64_t bytes) {
    const std::lock_guard lock(mutex_);
    return bytes_ + bytes > bytes_max_;
}

}  // namespace raynest::server::device
