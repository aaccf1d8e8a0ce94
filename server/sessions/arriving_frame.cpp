// The lease of a conversation on the frame that is on its way.
#include "server/sessions/arriving_frame.h"

#include "server/scheduling/peers.h"
#include "server/sessions/conversation.h"

#include <memory>
#include <utility>

namespace raynest::server {

bool Conversation::cover(const protocol::FrameHeader& header) {
    const std::uint64_t id = header.request_id;
    const std::uint64_t bytes = header.bulk_bytes;
    const auto parked = parked_.find(id);
    if (parked == parked_.end()) {
        arriving_ = ArrivingFrame(runner_of(id).admit(id, bytes), bytes);
        return arriving_.is_covered();
    }
    auto lease = services_.peers.reserve(bytes, caller_.principal);
    if (!lease) {
        refuse_parked(parked,
                      services_.budget
                          .refuse("the data of the request", bytes, caller_.principal, "try later")
                          .value());
        return false;
    }
    arriving_ = ArrivingFrame(std::make_shared<Budget::Lease>(std::move(*lease)), bytes);
    return true;
}

std::uint64_t Conversation::held_bytes() const {
    std::uint64_t bytes = runner_->held_bytes() + arriving_.held_bytes();
    for (const auto& [id, parked] : parked_) bytes += parked.lease.bytes();
    for (const auto& [id, job] : feeding_) bytes += job->runner().held_bytes() + job->bytes();
    return bytes;
}

}  // namespace raynest::server
