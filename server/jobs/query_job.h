// The base of all queries: receives or generates rays and deals them out in chunks. Derived classes
// define the answer of a chunk.
#pragma once

#include "server/execution/ray_input.h"
#include "server/jobs/chunked_job.h"
#include "server/jobs/ray_source.h"
#include "server/jobs/scene_steps.h"
#include "server/security/caller.h"

#include <cstdint>
#include <memory>
#include <optional>

namespace raynest::server {

/// Maximum bytes of an answer frame, whatever the window: larger frames fall out of the cache and
/// cost 1.5 times as much to send.
inline constexpr std::uint64_t answer_frame_bytes_max = 4ULL << 20;
/// Returns the maximum bytes of an answer frame to this client: half of its window, so that one
/// frame never needs more credit than the client returns, but at most answer_frame_bytes_max.
[[nodiscard]] std::uint64_t frame_bytes_max(const Caller& caller);

/// Maximum bytes of an answer's header and control message, which describes at most 64 blocks.
inline constexpr std::uint64_t answer_head_bytes_max = 8ULL << 10;

/// The base of query jobs.
class QueryJob : public ChunkedJob {
public:
    /// Returns the maximum bytes of all answers with headers, which a detached query reserves; for
    /// kind all, the usual bytes.
    [[nodiscard]] virtual std::uint64_t result_bytes() const = 0;

    Frames greeting() override;
    Reply<std::uint64_t> feed(protocol::Frame frame) override;
    std::optional<Task> next() override;
    Reply<void> ended() override;
    [[nodiscard]] std::uint64_t held_bytes() const override {
        return ChunkedJob::held_bytes() + (sweep_ != nullptr ? sweep_->held_bytes() : 0);
    }
    [[nodiscard]] bool needs_input() const override {
        return sweep_ != nullptr ? sweep_->needs_input() : !input_.complete();
    }
    [[nodiscard]] bool finished() const override { return queue_.all_answered(); }
    Frames farewell() override;
    std::uint64_t take_freed_input() override {
        return sweep_ != nullptr ? sweep_->take_freed() : input_.take_freed();
    }
    [[nodiscard]] std::optional<Progress> progress() const override;

protected:
    QueryJob(const Services& services, const Caller& caller, Plan plan, RaySource source);

    /// Returns null unless the chunk may be traced together with those of other jobs.
    [[nodiscard]] virtual std::shared_ptr<const MergeableTask> mergeable(const Chunk& /*chunk*/) {
        return nullptr;
    }
    /// Returns the maximum bulk bytes of the answer to a chunk of `rays` rays.
    [[nodiscard]] virtual std::uint64_t reply_bytes(std::uint64_t rays) const = 0;
    /// Number of rows of the whole answer; valid once all rays are answered.
    [[nodiscard]] virtual std::uint64_t rows() const = 0;

    /// Marks rays [first, first + count) as answered. Any thread.
    void answered(const Chunk& chunk, std::uint64_t count);
    /// The plan of a chunk: of the scene as it is then. Any thread.
    [[nodiscard]] std::shared_ptr<const Plan> plan_of(const Chunk& chunk) const;
    /// Traces a chunk with its plan. Any thread.
    Traced<TracedRays> trace_rays_of(const Plan& plan, const Chunk& chunk, const Stop& stop,
                                     TraceBuffers& buffers, bool any_order);
    /// There are steps if the source has a motion: chunks are of places (step_order.h).
    [[nodiscard]] const SceneSteps& steps() const { return *steps_; }

    const RaySource source_;
    RayInput input_;

private:
    SentSweep* const sweep_;  ///< null unless the client sends a trajectory
    std::optional<SceneSteps> steps_;
};

}  // namespace raynest::server
