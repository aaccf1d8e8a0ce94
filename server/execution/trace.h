// Tracing rays on a backend, and the memory for rays and hits.
#pragma once

#include "server/execution/plan.h"
#include "server/ground/budget.h"

#include <cstdint>
#include <memory>
#include <mutex>
#include <new>
#include <span>
#include <vector>

namespace raynest::server {

/// Memory for one chunk's rays and hits. It counts towards --memory; its pool frees it as a whole.
struct TraceBuffers {
    explicit TraceBuffers(Budget& memory) : budget(memory) {}

    std::vector<Ray> rays;              ///< rays that the daemon generates
    std::vector<Ray> sent;              ///< sent rays, completed with what their frame shares
    std::vector<std::uint32_t> masks;   ///< the sent rays' own masks, if they have any
    std::vector<HitRecord> hits;        ///< hits_max per ray; packed for kind all
    std::vector<std::uint32_t> order;   ///< index of each row's ray and hit
    std::vector<std::uint32_t> counts;  ///< hits per ray, for kinds multi and all
    std::vector<std::uint8_t> flags;    ///< HitFlags per ray, for kind all
    std::vector<Counters> counters;     ///< Plan::counter_sets() per ray
    std::vector<std::vector<std::uint32_t>> outputs;  ///< [output of the intersector][ray]
    std::vector<HitRecord> occluders;                 ///< hits of an integrator's occlusion rays
    std::unique_ptr<TraceBuffers> of_masks;  ///< rays sorted by their masks, and their answers

    Budget& budget;
    Budget::Lease lease;           ///< for the capacity of all vectors
    std::uint64_t used_bytes = 0;  ///< the most that a chunk used since the last trim()

    /// Resizes a vector; its contents may be lost. Throws std::bad_alloc, also beyond --memory.
    template <class T>
    void resize(std::vector<T>& vector, std::size_t count) {
        if (count > vector.capacity()) grow(vector, count);
        vector.resize(count);
    }

    /// Resizes the intersector's outputs for `count` rays. Returns their columns for a TraceCall.
    std::vector<void*> resize_outputs(const Plan& plan, std::size_t count);
    /// Bytes in use, not the capacity.
    [[nodiscard]] std::uint64_t bytes() const;
    /// Bytes of the capacity.
    [[nodiscard]] std::uint64_t held_bytes() const;

private:
    template <class T>
    void grow(std::vector<T>& vector, std::size_t count);
};

/// The buffers of the daemon: one for each running chunk, and idle ones. Thread-safe.
class TraceBufferPool {
public:
    explicit TraceBufferPool(Budget& budget) : budget_(budget) {}
    TraceBufferPool(const TraceBufferPool&) = delete;

    /// Deleter that returns buffers to the pool.
    struct GiveBack {
        TraceBufferPool* pool;
        void operator()(TraceBuffers* buffers) const noexcept { pool->give_back(buffers); }
    };
    using Use = std::unique_ptr<TraceBuffers, GiveBack>;

    /// Returns the idle buffers that were used last, because their pages are warm, or new ones.
    [[nodiscard]] Use take();
    /// Returns idle buffers of which at most half was used since the last call. To free them takes
    /// milliseconds.
    [[nodiscard]] std::vector<std::unique_ptr<TraceBuffers>> trim();

private:
    void give_back(TraceBuffers* buffers) noexcept;

    Budget& budget_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<TraceBuffers>> idle_;  ///< capacity for all count_ buffers
    std::size_t count_ = 0;
};

/// Rays and their hits, as views of TraceBuffers.
struct TracedRays {
    std::span<const Ray> rays = {};
    std::span<HitRecord> hits = {};  ///< empty for kind null
    std::span<const std::uint32_t> order =
        {};  ///< index of each row's ray and hit; empty: in order
    std::span<const std::uint32_t> counts = {};
    std::span<const std::uint8_t> flags = {};
    std::span<const Counters> counters = {};
    std::span<const std::vector<std::uint32_t>> outputs = {};
    std::size_t first = 0;         ///< index in `outputs` of the first row
    std::uint32_t traversals = 0;  ///< bit t: traversal t ran
    std::size_t backend = 0;       ///< index in the plan's BackendChoice::order

    [[nodiscard]] std::size_t rows() const { return order.empty() ? rays.size() : order.size(); }
    /// Returns rows [first, first + count); `first` must be 0 for kind all.
    [[nodiscard]] TracedRays slice(std::size_t first, std::size_t count) const;
};

/// Traces rays on the plan's backend of this index. The hits lie in `buffers`. Returns all rays;
/// for kind all, as many as had room for their hits. Kind null returns rays without hits. `camera`,
/// for a backend with makes_camera_rays(), generates the rays; the contents of `rays` are then not
/// read. Returns CANCELLED if `stop` was requested: the CPU stops even within a ray, a GPU does
/// not.
Traced<TracedRays> trace_rays(const Plan& plan, std::size_t backend, std::span<const Ray> rays,
                              const Stop& stop, TraceBuffers& buffers,
                              const PinholeRays* camera = nullptr);

/// The same for rays with a mask each: what a ray enters has a bit of its mask and of the plan's.
/// Backends know one mask per call, so that rays of equal masks are traced in calls of their own.
Traced<TracedRays> trace_masked_rays(const Plan& plan, std::size_t backend,
                                     std::span<const Ray> rays,
                                     std::span<const std::uint32_t> masks, const Stop& stop,
                                     TraceBuffers& buffers);

template <class T>
void TraceBuffers::grow(std::vector<T>& vector, std::size_t count) {
    const std::uint64_t freed = vector.capacity() * sizeof(T);
    std::vector<T>().swap(vector);  // free first: old and new together may exceed --memory
    lease.shrink(lease.bytes() - freed);
    auto room = budget.reserve(count * sizeof(T));
    if (!room) throw std::bad_alloc();
    vector.reserve(count);
    lease.merge(std::move(*room));
}

}  // namespace raynest::server
