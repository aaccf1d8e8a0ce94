#include "server/store/disk_room.h"

#include "protocol/text.h"

namespace raynest::server {

Reply<void> DiskRoom::check(std::uint64_t needed) const {
    if (needed <= bytes) return {};
    return refuse(Code::quota, owner + " has room for " + protocol::bytes_text(bytes) +
                                   " in the state folder, " + protocol::bytes_text(needed) +
                                   " are too many: " + remedy);
}

Claim Claims::of(const std::string& owner) const {
    const std::lock_guard lock(taken_->mutex);
    const auto found = taken_->sums.find(owner);
    return found == taken_->sums.end() ? Claim() : found->second;
}

std::shared_ptr<void> Claims::take(const std::string& owner, const Claim& claim) {
    const auto give_back = [taken = taken_, owner, claim](void*) {
        const std::lock_guard lock(taken->mutex);
        const auto found = taken->sums.find(owner);
        Claim& sum = found->second;
        sum.disk_bytes -= claim.disk_bytes;
        sum.scenes -= claim.scenes;
        sum.scene_bytes -= claim.scene_bytes;
        if (sum == Claim()) taken->sums.erase(found);
    };
    {
        const std::lock_guard lock(taken_->mutex);
        Claim& sum = taken_->sums[owner];
        sum.disk_bytes += claim.disk_bytes;
        sum.scenes += claim.scenes;
        sum.scene_bytes += claim.scene_bytes;
    }
    return {taken_.get(), give_back};
}

}  // namespace raynest::server
