// The base of all jobs that trace rays: a plan, a queue of chunks, and a way for each of them to a
// backend and back.
//
//   ChunkQueue ──► task ──► trace(chunk) ──► frames
//        ▲                      │ try elsewhere
//        └──────────────────────┘
#pragma once

#include "server/execution/chunk_queue.h"
#include "server/execution/plan.h"
#include "server/execution/statistics.h"
#include "server/execution/trace.h"

#include <cstdint>
#include <optional>

namespace raynest::server {

class ChunkedJob : public Job {
protected:
    /// `total`: how much there is to be answered, in the unit of its chunks. `joins` as in
    /// ChunkQueue.
    ChunkedJob(const Services& services, const Caller& caller, Plan plan, std::uint64_t total,
               bool joins);

    /// The most that a chunk may hold for this backend. It begins where `rest` does.
    [[nodiscard]] virtual std::uint64_t chunk_size(const Backend& backend,
                                                   const Chunk& rest) const = 0;
    /// Any thread: traces a chunk, and gives the frames that answer it. Adds to the statistics and
    /// counts in the queue what it answered.
    virtual Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) = 0;

    /// The next chunk that waits, and a task that traces it.
    struct Work {
        Chunk chunk;
        Task task;
    };
    std::optional<Work> next_work();

    /// DONE, as far as the statistics know it.
    [[nodiscard]] wire::DoneT done() const { return statistics_.done(plan_, queue_); }

    const Services& services_;
    const std::uint64_t id_;
    const Plan plan_;
    ChunkQueue queue_;
    JobStatistics statistics_;

private:
    Reply<Frames> run(const Chunk& chunk, const Stop& stop);
};

}  // namespace raynest::server
