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
    const auto idle = std::find_if(residents_.begin(), residents_.end(),
                                   [](const Resident& resident) { return resident.users == 0; });
    if (idle == residents_.end()) return false;
    device_.unload(idle->scene);
    bytes_ -= idle->bytes;
    residents_.erase(idle);
    return true;
}

TraceStatus Residents::load(std::string_view hash, const SceneView& scene) {
    const std::lock_guard lock(mutex_);
    if (find_locked(hash) != residents_.end()) return trace_ok;
    Resident resident{std::string(hash)};
    TraceStatus status = device_.load(&scene, &resident.scene);
    while (status == trace_out_of_memory && evict_one())
        status = device_.load(&scene, &resident.scene);
    if (status != trace_ok) return status;
    resident.bytes = device_.bytes_of(resident.scene);
    bytes_ += resident.bytes;
    while (bytes_ > bytes_max_ && evict_one()) {
    }
    residents_.push_back(std::move(resident));
    return trace_ok;
}

}  // namespace raynest::server::device
