#include "server/execution/chunk_queue.h"

namespace raynest::server {

void ChunkQueue::add(std::uint64_t first, std::uint64_t count) {
    const std::lock_guard lock(mutex_);
    waiting_.push_back({first, count});
}

Reply<void> ChunkQueue::redeal(Chunk chunk, const Unavailable& why) {
    const Backend& backend = backend_of(chunk);
    if (chunk.backend + 1 == backends_.order.size())
        return tl::unexpected(unavailable_error(backend, why));
    ++chunk.backend;
    const std::lock_guard lock(mutex_);
    if (redealt_reason_.empty()) redealt_reason_ = backend.title() + ": " + why.reason;
    waiting_.push_front(chunk);
    return {};
}

void ChunkQueue::give_back(const Chunk& rest) {
    const std::lock_guard lock(mutex_);
    waiting_.push_front(rest);
}

std::string ChunkQueue::redealt_reason() const {
    const std::lock_guard lock(mutex_);
    return redealt_reason_;
}

}  // namespace raynest::server
