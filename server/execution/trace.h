// Rays through a backend, and the memory that their hits lie in.
#pragma once

#include "server/execution/plan.h"
#include "server/store/budget.h"

#include <cstdint>
#include <memory>
#include <mutex>
#include <new>
#include <span>
#include <vector>

namespace raynest::server {

/// Room for one chunk's rays and hits. Counts towards --memory; its pool frees it as a whole.
struct TraceBuffers {
    explicit TraceBuffers(Budget& memory) : budget(memory) {}

    std::vector<Ray> rays;              ///< for callers that make their own
    std::vector<Ray> sent;              ///< for those that came without what they have in common
    std::vector<HitRecord> hits;        ///< hits_max per ray; of `all` packed
    std::vector<std::uint32_t> order;   ///< the hit of each row
    std::vector<std::uint32_t> counts;  ///< hits per ray, multi and all only
    std::vector<std::uint8_t> flags;    ///< HitFlags per ray, all only
    std::vector<Counters> counters;     ///< per ray, counting only
    std::vector<std::vector<std::uint32_t>> outputs;  ///< per output of the intersector: per ray
    std::vector<HitRecord> occluders;  ///< of rays that only ask whether there is one

    Budget& budget;
    Budget::Lease lease;           ///< of their capacities
    std::uint64_t used_bytes = 0;  ///< the most that a chunk used since the last trim()

    /// Makes a vector `count` long; what it held may be lost. Throws std::bad_alloc also where
    /// --memory has no room for it.
    template <class T>
    void resize(std::vector<T>& vector, std::size_t count) {
        if (count > vector.capacity()) grow(vector, count);
        vector.resize(count);
    }

    /// Makes room for the intersector's outputs of `count` rays, and gives the columns of a call.
    std::vector<void*> resize_outputs(const Plan& plan, std::size_t count);
    /// Bytes of what lies in them now.
    [[nodiscard]] std::uint64_t bytes() const;

private:
    template <class T>
    void grow(std::vector<T>& vector, std::size_t count);
};

/// The buffers of a daemon: one per chunk that is traced, and those that wait for the next ones.
/// Thread-safe.
class TraceBufferPool {
public:
    explicit TraceBufferPool(Budget& budget) : budget_(budget) {}
    TraceBufferPool(const TraceBufferPool&) = delete;

    /// Gives its buffers back at its end.
    struct GiveBack {
        TraceBufferPool* pool;
        void operator()(TraceBuffers* buffers) const noexcept { pool->give_back(buffers); }
    };
    using Use = std::unique_ptr<TraceBuffers, GiveBack>;

    /// The buffers that were used last, whose pages are warm; or new ones.
    [[nodiscard]] Use take();
    /// Frees those that were not needed since the last call, or not half of them.
    void trim();

private:
    void give_back(TraceBuffers* buffers) noexcept;

    Budget& budget_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<TraceBuffers>> idle_;  ///< room for all of them
    std::size_t count_ = 0;
};

/// Rays and what was found for them: views of TraceBuffers.
struct TracedRays {
    std::span<const Ray> rays = {};
    std::span<HitRecord> hits = {};             ///< none where nothing is traced
    std::span<const std::uint32_t> order = {};  ///< the ray and hit of each row; empty: in order
    std::span<const std::uint32_t> counts = {};
    std::span<const std::uint8_t> flags = {};
    std::span<const Counters> counters = {};
    std::span<const std::vector<std::uint32_t>> outputs = {};
    std::size_t first = 0;  ///< of `outputs`: the place of the first row
    Traversal traversal = traversal_single;
    std::size_t backend = 0;  ///< place in the plan's order

    [[nodiscard]] std::size_t rows() const { return order.empty() ? rays.size() : order.size(); }
    /// `count` rows from `first` on; of `all` from 0 on.
    [[nodiscard]] TracedRays slice(std::size_t first, std::size_t count) const;
};

/// Traces rays and gives them with their hits, which lie in `buffers`: all of them, but where the
/// hits of `all` have no more room. A plan that traces nothing has no hits. `camera`: one that
/// makes these rays, for a backend that makes them itself; they need not lie in `rays`.
/// CANCELLED where `stop` is requested meanwhile, within a ray too; on a GPU after the call.
Traced<TracedRays> trace_rays(const Plan& plan, std::size_t backend, std::span<const Ray> rays,
                              const Stop& stop, TraceBuffers& buffers,
                              const PinholeRays* camera = nullptr);

template <class T>
void TraceBuffers::grow(std::vector<T>& vector, std::size_t count) {
    const std::uint64_t freed = vector.capacity() * sizeof(T);
    std::vector<T>().swap(vector);  // first: both together need not fit
    lease.shrink(lease.bytes() - freed);
    auto room = budget.reserve(count * sizeof(T));
    if (!room) throw std::bad_alloc();
    vector.reserve(count);
    lease.merge(std::move(*room));
}

}  // namespace raynest::server
