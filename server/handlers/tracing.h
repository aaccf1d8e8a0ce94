// One chunk of rays through a job's compiled function, on a worker thread.
#pragma once

#include "server/handlers/plan.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <limits>
#include <mutex>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

/// What a kernel wrote for one chunk. One per worker thread, reused from chunk to chunk, so that
/// the pages of these arrays are touched once and not once per chunk.
struct TraceBuffers {
    std::vector<Ray> rays;              ///< for callers that make their own
    std::vector<Ray> sent;              ///< for those that came without what they have in common
    std::vector<HitRecord> hits;        ///< hits_max per ray; of `all` packed
    std::vector<std::uint32_t> order;   ///< the hit of each row; empty: in order
    std::vector<std::uint32_t> counts;  ///< hits per ray, multi and all only
    std::vector<std::uint8_t> flags;    ///< HitFlags per ray, all only
    std::vector<Counters> counters;     ///< per ray, counting only
    std::vector<std::vector<std::uint32_t>> outputs;  ///< per output of the intersector: per ray
    std::uint32_t answered = 0;                       ///< rays, from the first on; at least one

    Traversal traversal = traversal_latency;  ///< that gave the answers
    bool on_cuda = false;                     ///< they came from there
    std::string fallback;                     ///< why they do not, where they should have

    [[nodiscard]] static TraceBuffers& of_this_thread();

    /// Copies `count` of the traced `rays`, and their answers, to another: of closest, any and
    /// multi, as a GPU gives them.
    void copy(std::size_t first, std::size_t count, std::span<const Ray> from,
              TraceBuffers& to) const;
};

/// A chunk's hit records fit into this; it bounds the rays of a chunk where a ray has many hits.
inline constexpr std::uint64_t hit_bytes_max = 8ULL << 20;

/// Rays of a GPU's call at most: `cuda_rays_max`, but a frame's at least, and what hits have room
/// for at most. A large GPU has more threads at a time than a frame has rays. Other jobs' calls,
/// cancels and deadlines wait for no more than the few calls before them: at 2^17 rays some
/// milliseconds each, of rays as they usually are. Where a small GPU needs cuda_call_ms_max for
/// rays that it gives up, fewer are better.
[[nodiscard]] inline std::uint64_t call_rays_max(const protocol::Limits& limits) {
    return std::clamp(limits.cuda_rays_max, limits.chunk_rays_max,
                      hit_bytes_max / sizeof(HitRecord));
}

/// Fills `buffers` (all but its rays) with the answers of `rays`: of all of them, but where the
/// hits of `all` have no more room. Of a plan that traces nothing there are no hits. `made`: a
/// camera that makes these rays, where a GPU is to; they need not lie in `rays`.
///
/// What a CUDA worker gives up is an error, with which the job ends where the plan demands it
/// there. Else `buffers.fallback` says why: the caller has it traced again in Lane::compute, in
/// chunks of a CPU, with that set.
/// CANCELLED where `stop` is requested meanwhile, within a ray too; on a GPU after the call.
Reply<void> trace(const Plan& plan, std::span<const Ray> rays, const Stop& stop,
                  TraceBuffers& buffers, const PinholeRays* made = nullptr);

/// What DONE tells about a job; written by its tasks on any thread.
class Tally {
public:
    /// A task starts.
    void begin();
    /// A task ended, with so many of each.
    struct Counts {
        std::uint64_t rays = 0;
        std::uint64_t hits = 0;
        std::uint64_t misses = 0;     ///< rays without a hit
        std::uint64_t truncated = 0;  ///< rays with more hits than their budget
        std::uint64_t invalid = 0;    ///< rays that are none: misses, too
        std::uint64_t first_invalid = 0;

        /// Adds a record of each ray but to `hits`: rows of the query from `first` on, in `order`
        /// as in TraceBuffers.
        void add_rays(std::span<const HitRecord> records, std::span<const std::uint32_t> order,
                      std::uint64_t first);
    };
    void add(const TraceBuffers& buffers, const Counts& counts);

    [[nodiscard]] std::uint64_t rays() const { return rays_; }
    [[nodiscard]] std::uint64_t hits() const { return hits_; }
    /// Rays, hits, times, target, traversal, worker and notes of DONE.
    [[nodiscard]] wire::DoneT done(const Plan& plan) const;

private:
    using Ticks = Clock::duration::rep;
    const Clock::time_point accepted_ = Clock::now();
    std::atomic<std::uint64_t> rays_{0};
    std::atomic<std::uint64_t> hits_{0};
    std::atomic<std::uint64_t> misses_{0};
    std::atomic<std::uint64_t> truncated_{0};
    std::atomic<std::uint64_t> invalid_{0};
    std::atomic<std::uint64_t> first_invalid_{std::numeric_limits<std::uint64_t>::max()};
    std::atomic<std::uint32_t> traversals_{0};  ///< bit t: traversal t gave answers
    std::atomic<Ticks> first_{0};               ///< since accepted_; 0: nothing began yet
    std::atomic<Ticks> last_{0};
    std::atomic<std::uint64_t> cuda_chunks_{0};
    std::atomic<std::uint64_t> cpu_chunks_{0};

    mutable std::mutex mutex_;
    std::uint64_t fallen_back_ = 0;  ///< chunks
    std::string fallback_;           ///< why the first one did
};

}  // namespace raynest::server
