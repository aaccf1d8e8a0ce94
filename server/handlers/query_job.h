// The base of all queries: takes rays in, or makes them, and hands them out in chunks. They differ
// in how a chunk becomes an answer.
#pragma once

#include "server/execution/chunked_job.h"
#include "server/execution/ray_input.h"
#include "server/handlers/ray_source.h"

#include <cstdint>
#include <memory>

namespace raynest::server {

/// No answer may be larger, so that half of the client's window is enough for it; and cache-sized
/// ones cost less to send than larger ones (1.5 times, measured).
[[nodiscard]] std::uint64_t frame_bytes_max(const Caller& caller);

/// Header and control message of an answer: a name and a description for each of at most 64 blocks.
inline constexpr std::uint64_t answer_head_bytes_max = 8ULL << 10;

class QueryJob : public ChunkedJob {
public:
    /// Bytes of all answers, headers included: what a detached query reserves. At most; where hits
    /// are not known in advance, what is usual.
    [[nodiscard]] virtual std::uint64_t result_bytes() const = 0;

    Frames greeting() override;
    Reply<std::uint64_t> feed(protocol::Frame frame) override;
    std::optional<Task> next() override;
    [[nodiscard]] bool needs_input() const override { return !input_.complete(); }
    [[nodiscard]] bool finished() const override { return queue_.all_answered(); }
    Frames farewell() override;
    std::uint64_t take_freed_input() override { return input_.take_freed(); }
    [[nodiscard]] std::optional<Progress> progress() const override;

protected:
    QueryJob(const Services& services, const Caller& caller, Plan plan, RaySource source);

    /// Not null where a chunk may be traced together with those of other jobs.
    [[nodiscard]] virtual std::shared_ptr<const MergeableTask> mergeable(const Chunk& /*chunk*/) {
        return nullptr;
    }
    /// Bulk bytes of the answer to a chunk of so many rays, at most.
    [[nodiscard]] virtual std::uint64_t reply_bytes(std::uint64_t rays) const = 0;
    /// Rows of the whole answer, once all is answered.
    [[nodiscard]] virtual std::uint64_t rows() const = 0;

    /// Any thread: rays [first, first + count) are answered.
    void answered(std::uint64_t first, std::uint64_t count);

    const RaySource source_;
    RayInput input_;
};

}  // namespace raynest::server
