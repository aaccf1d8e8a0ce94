// The chunks of a job: cut to what their backend takes, dealt again when it gives them up.
//
//   add ──► ranges that wait ──next: cut──► a task ──answered──► counted
//              ▲                              │
//              └──── redeal, give_back ◄──────┘
//
// A chunk is a value, and tracing it twice does no harm: the digest of the scene, the request and
// its first ray identify its answer.
#pragma once

#include "server/backends/backends.h"

#include <atomic>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>

namespace raynest::server {

/// A range of a job's work, in rays or pixels: the unit of scheduling.
struct Chunk {
    std::uint64_t first = 0;
    std::uint64_t count = 0;
    std::size_t backend = 0;  ///< place in BackendChoice::order; those before it gave the chunk up

    /// Cuts off the first `most`, or all.
    Chunk split(std::uint64_t most) {
        Chunk head{first, std::min(most, count), backend};
        first += head.count;
        count -= head.count;
        return head;
    }
};

class ChunkQueue {
public:
    /// `joins`: may a chunk for a backend with threads of its own consist of several ranges?
    ChunkQueue(const BackendChoice& backends, std::uint64_t total, bool joins)
        : backends_(backends),
          total_(total),
          joins_(joins) {}

    [[nodiscard]] Backend& backend_of(const Chunk& chunk) const {
        return *backends_.order[chunk.backend];
    }
    /// These can be traced now.
    void add(std::uint64_t first, std::uint64_t count);
    /// The next chunk; nothing where none waits. `rays_max` gives the bound of one that begins
    /// where its second argument does: rays_max(backend, chunk).
    template <class RaysMax>
    std::optional<Chunk> next(const RaysMax& rays_max);

    /// Any thread: the chunk's backend gave it up, the next one gets it. The error of the job where
    /// there is none.
    Reply<void> redeal(Chunk chunk, const Unavailable& why);
    /// Any thread: what did not fit an answer.
    void give_back(const Chunk& rest);
    /// Any thread: so much of a chunk is answered.
    void answered(std::uint64_t count) { answered_ += count; }
    [[nodiscard]] std::uint64_t answered() const { return answered_; }
    [[nodiscard]] bool all_answered() const { return answered_ == total_; }
    /// Why the first chunk was dealt again, for the user.
    [[nodiscard]] std::string redealt_reason() const;

private:
    const BackendChoice& backends_;
    const std::uint64_t total_;
    const bool joins_;
    std::atomic<std::uint64_t> answered_{0};
    mutable std::mutex mutex_;
    std::deque<Chunk> waiting_;  ///< neither answered nor under way
    std::string redealt_reason_;
};

template <class RaysMax>
std::optional<Chunk> ChunkQueue::next(const RaysMax& rays_max) {
    const std::lock_guard lock(mutex_);
    if (waiting_.empty()) return std::nullopt;
    const auto take = [this](std::uint64_t most) {
        const Chunk head = waiting_.front().split(most);
        if (waiting_.front().count == 0) waiting_.pop_front();
        return head;
    };
    Backend& backend = backend_of(waiting_.front());
    const std::uint64_t most = rays_max(backend, waiting_.front());
    Chunk chunk = take(most);
    // A frame of rays does not fill a GPU. It gets those that have come, and waits for none.
    const auto continues = [&] {
        return !waiting_.empty() && waiting_.front().first == chunk.first + chunk.count &&
               waiting_.front().backend == chunk.backend;
    };
    while (joins_ && backend.pool() != nullptr && chunk.count < most && continues())
        chunk.count += take(most - chunk.count).count;
    return chunk;
}

}  // namespace raynest::server
