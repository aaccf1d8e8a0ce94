#include "server/store/disk_room.h"

#include "protocol/text.h"

namespace raynest::server {

Reply<void> DiskRoom::check(std::uint64_t needed) const {
    if (needed <= bytes) return {};
    return refuse(Code::quota, owner + " has room for " + protocol::bytes_text(bytes) +
                                   " in the state folder, " + protocol::bytes_text(needed) +
                                   " are too many: " + remedy);
}

std::uint64_t DiskClaims::of(const std::string& owner) const {
    const std::lock_guard lock(taken_->mutex);
    const auto found = taken_->bytes.find(owner);
    return found == taken_->bytes.end() ? 0 : found->second;
}

std::shared_ptr<void> DiskClaims::take(const std::string& owner, std::uint64_t bytes) {
    const auto give_back = [taken = taken_, owner, bytes](void*) {
        const std::lock_guard lock(taken->mutex);
        const auto found = taken->bytes.find(owner);
        found->second -= bytes;
        if (found->second == 0) taken->bytes.erase(found);
    };
    {
        const std::lock_guard lock(taken_->mutex);
        taken_->bytes[owner] += bytes;
    }
    return {taken_.get(), give_back};
}

}  // namespace raynest::server
