#include "server/device/residents.h"

#include <algorithm>
#include <utility>

namespace raynest::server::device {

Residents::Residence Residents::find_locked(std::string_view hash) {
    return std::find_if(residents_.begin(), residents_.end(),
                        [&](const Resident& resident) { return resident.hash == hash; });
}

Residents::Use Residents::find(std::string_view hash) {
    const std::lock_guard lock(mutex_);
    const Residence found = find_locked(hash);
    if (found == residents_.end()) return {};
    residents_.splice(residents_.end(), residents_, found);
    ++found->users;
    return {this, found};
}

Residents::Use::~Use() {
    if (owner_ == nullptr) return;
    const std::lock_guard lock(owner_->mutex_);
    --resident_->users;
}

bool Residents::evict_one() {
    std::list<Resident> evicted;
    {
        const std::lock_guard lock(mutex_);
        const auto idle =
            std::find_if(residents_.begin(), residents_.end(),
                         [](const Resident& resident) { return resident.users == 0; });
        if (idle == residents_.end()) return false;
        bytes_ -= idle->bytes;
        evicted.splice(evicted.end(), residents_, idle);
    }
    device_.unload(evicted.front().scene);
    return true;
}

TraceStatus Residents::load(std::string_view hash, const SceneView& scene) {
    if (find(hash).scene() != nullptr) return trace_ok;
    std::list<Resident> loaded(1);
    Resident& resident = loaded.front();
    resident.hash = hash;
    // Calls of other scenes go on meanwhile: a large scene takes seconds.
    TraceStatus status = device_.load(&scene, &resident.scene);
    while (status == trace_out_of_memory && evict_one())
        status = device_.load(&scene, &resident.scene);
    if (status != trace_ok) return status;
    resident.bytes = device_.bytes_of(resident.scene);
    while (would_exceed(resident.bytes) && evict_one()) {
    }
    const std::lock_guard lock(mutex_);
    bytes_ += resident.bytes;
    residents_.splice(residents_.end(), loaded);
    return trace_ok;
}

bool Residents::would_exceed(std::uint64_t bytes) {
    const std::lock_guard lock(mutex_);
    return bytes_ + bytes > bytes_max_;
}

}  // namespace raynest::server::device
