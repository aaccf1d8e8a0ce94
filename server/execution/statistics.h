// The statistics of a job for its DONE message; its tasks add to them.
#pragma once

#include "protocol/wire.h"
#include "server/execution/chunk_queue.h"
#include "server/execution/plan.h"
#include "server/execution/trace.h"

#include <array>
#include <atomic>
#include <cstdint>
#include <limits>

namespace raynest::server {

/// Sums over the chunks of a job. Thread-safe.
class JobStatistics {
public:
    /// Records the start of the first task; later calls do nothing.
    void begin();

    /// The counts of one chunk.
    struct Counts {
        std::uint64_t rays = 0;
        std::uint64_t hits = 0;
        std::uint64_t misses = 0;     ///< rays without a hit
        std::uint64_t truncated = 0;  ///< rays with more hits than their budget
        std::uint64_t invalid = 0;    ///< invalid rays; they count as misses too
        std::uint64_t first_invalid = 0;

        /// Sets the counts, except `rays` and `hits`, from one record per ray. The rows are those
        /// of the query from `first` on; `order` as in TracedRays.
        void add_rays(std::span<const HitRecord> records, std::span<const std::uint32_t> order,
                      std::uint64_t first);
    };
    /// Adds an answered chunk; `backend` is an index in the plan's BackendChoice::order, and bit t of
    /// `traversals` tells that traversal t ran.
    void add(std::size_t backend, std::uint32_t traversals, const Counts& counts);

    [[nodiscard]] std::uint64_t hits() const { return hits_; }
    /// Returns DONE with rays, hits, times, target, traversal, worker and notes.
    [[nodiscard]] wire::DoneT done(const Plan& plan, const ChunkQueue& queue) const;

private:
    using Ticks = Clock::duration::rep;
    static constexpr std::size_t backends_max = 8;

    const Clock::time_point accepted_ = Clock::now();
    std::atomic<std::uint64_t> rays_{0};
    std::atomic<std::uint64_t> hits_{0};
    std::atomic<std::uint64_t> misses_{0};
    std::atomic<std::uint64_t> truncated_{0};
    std::atomic<std::uint64_t> invalid_{0};
    std::atomic<std::uint64_t> first_invalid_{std::numeric_limits<std::uint64_t>::max()};
    std::atomic<std::uint32_t> traversals_{0};  ///< bit t: traversal t was used
    std::atomic<Ticks> first_{0};               ///< first start, since accepted_; 0: none yet
    std::atomic<Ticks> last_{0};                ///< last answer, since accepted_
    std::array<std::atomic<std::uint64_t>, backends_max> chunks_{};  ///< answered, per backend
};

}  // namespace raynest::server
