// The base of all jobs that trace rays: a plan, a queue of chunks, and the tasks that trace them.
//
//   ChunkQueue ──► task ──► trace(chunk) ──► frames
//        ▲                      │ try elsewhere
//        └──────────────────────┘
#pragma once

#include "server/execution/chunk_queue.h"
#include "server/execution/plan.h"
#include "server/execution/statistics.h"
#include "server/execution/trace.h"
#include "server/jobs/services.h"
#include "server/security/caller.h"

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace raynest::server {

class ChunkedJob : public Job {
public:
    std::optional<Task> prepare() override;
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return (plan_.selected != nullptr ? plan_.selected->bytes() : 0) +
               plan_.scene.left_bytes(principal_);
    }

protected:
    /// `total` is the size of the job in the unit of its chunks. `joins` as in ChunkQueue.
    ChunkedJob(const Services& services, const Caller& caller, Plan plan, std::uint64_t total,
               bool joins);

    /// True if make_ready() has something to do; a task for it costs a small query its latency.
    [[nodiscard]] virtual bool needs_preparation() const { return plan_.needs_select(); }
    /// Makes what tasks need and what grows with the request or the scene. Runs in prepare()'s
    /// task.
    virtual Reply<void> make_ready(const Stop& stop) { return plan_.select(stop); }

    /// Returns the maximum size of a chunk that begins at rest.first, for this backend.
    [[nodiscard]] virtual std::uint64_t chunk_size(const Backend& backend,
                                                   const Chunk& rest) const = 0;
    /// Traces a chunk and returns the frames of its answer. Adds the answered rays to the
    /// statistics and to the queue's count. Any thread.
    virtual Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) = 0;

    /// The next waiting chunk, and a task that traces it.
    struct Work {
        Chunk chunk;
        Task task;
    };
    std::optional<Work> next_work();

    /// Counts rays that a chunk traced. Any thread.
    void count_rays(std::string_view kind, const Chunk& chunk, std::uint64_t rays);

    /// Returns DONE with the fields that the statistics know.
    [[nodiscard]] wire::DoneT done() const { return statistics_.done(plan_, queue_); }

    const Services& services_;
    const std::string principal_;
    const std::uint64_t id_;
    const Plan plan_;
    ChunkQueue queue_;
    JobStatistics statistics_;

private:
    Reply<Frames> run(const Chunk& chunk, const Stop& stop);
};

}  // namespace raynest::server
