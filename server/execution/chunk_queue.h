// The chunks of a job, cut to the size that their backend takes, and redealt when it gives them up.
//
//   add ──► waiting ranges ────next: cut──► a task ──answered──► counted
//              ▲                              │
//              └──── redeal, give_back ◄──────┘
//
// A chunk is a value, and tracing it twice is harmless: its answer depends only on the scene's
// digest, the request and the range.
#pragma once

#include "server/execution/backend.h"

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
    std::size_t backend = 0;  ///< index in BackendChoice::order; earlier ones gave the chunk up

    /// Removes the first `most` rays or pixels, or all if there are fewer, and returns them.
    Chunk split(std::uint64_t most) {
        Chunk head{first, std::min(most, count), backend};
        first += head.count;
        count -= head.count;
        return head;
    }
};

/// The chunks of a job that are neither answered nor running.
class ChunkQueue {
public:
    /// `total` is the size of the job. If `joins`, adjacent ranges are merged into larger chunks
    /// for a backend with threads of its own.
    ChunkQueue(const BackendChoice& backends, std::uint64_t total, bool joins)
        : backends_(backends),
          total_(total),
          joins_(joins) {}

    [[nodiscard]] Backend& backend_of(const Chunk& chunk) const {
        return *backends_.order[chunk.backend];
    }
    /// Adds a range that can be traced.
    void add(std::uint64_t first, std::uint64_t count);
    /// Removes the next chunk; nothing if none waits. rays_max(backend, waiting) returns the
    /// maximum size of a chunk that begins at waiting.first.
    template <class RaysMax>
    std::optional<Chunk> next(const RaysMax& rays_max);

    /// Passes a chunk that its backend gave up to the next backend. Returns the error of the job if
    /// there is none left. Any thread.
    Reply<void> redeal(Chunk chunk, const Unavailable& why);
    /// Returns the rest of a chunk that did not fit its answer. Any thread.
    void give_back(const Chunk& rest);
    /// Counts rays or pixels as answered. Any thread.
    void answered(std::uint64_t count) { answered_ += count; }
    [[nodiscard]] std::uint64_t answered() const { return answered_; }
    [[nodiscard]] bool all_answered() const { return answered_ == total_; }
    /// Returns why the first chunk was redealt, for the user. Any thread.
    [[nodiscard]] std::string redealt_reason() const;

private:
    const BackendChoice& backends_;
    const std::uint64_t total_;
    const bool joins_;
    std::atomic<std::uint64_t> answered_{0};
    mutable std::mutex mutex_;
    std::deque<Chunk> waiting_;  ///< neither answered nor running
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
    // Join the ranges that have arrived, without waiting for more: one frame does not fill a GPU.
    const auto continues = [&] {
        return !waiting_.empty() && waiting_.front().first == chunk.first + chunk.count &&
               waiting_.front().backend == chunk.backend;
    };
    while (joins_ && backend.pool() != nullptr && chunk.count < most && continues())
        chunk.count += take(most - chunk.count).count;
    return chunk;
}

}  // namespace raynest::server
