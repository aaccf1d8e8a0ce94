#include "server/handlers/tracing.h"

#include <algorithm>
#include <bit>
#include <chrono>

namespace raynest::server {
namespace {

Reply<void> trace_on_cuda(const Plan& plan, const TraceCall& call, const PinholeRays* made,
                          TraceBuffers& buffers) {
    const device::Kernel kernel{plan.variant->name, plan.precision, plan.query,
                                plan.settings.params.size()};
    const auto traced = plan.worker.cuda->trace(kernel, plan.scene.snapshot(), call, made);
    if (traced) return {};
    if (!plan.worker.demanded()) buffers.fallback = traced.error().reason;
    return tl::unexpected(cuda_refused(traced.error()));
}

/// Of one chunk: stops it with its job, and at the end of its own time. A thread is not for ever.
class ChunkStop final : public Stop {
public:
    ChunkStop(const Stop& job, std::chrono::milliseconds time)
        : job_(job),
          end_(Clock::now() + time) {}
    [[nodiscard]] bool requested() const noexcept override {
        if (job_.requested()) return true;
        // Of short rays a question comes each microsecond or two; a clock takes 25 ns.
        constexpr unsigned questions_per_look = 4;
        return ++questions_ % questions_per_look == 0 && Clock::now() >= end_;
    }

private:
    const Stop& job_;
    const Clock::time_point end_;
    mutable unsigned questions_ = 0;
};

bool is_requested(const void* chunk) noexcept {
    return static_cast<const ChunkStop*>(chunk)->requested();
}

/// Why a call was cancelled.
protocol::Error cut_short(const Plan& plan, const Stop& stop) {
    if (stop.requested()) return {Code::cancelled, "", 0};
    return {Code::limit_exceeded,
            "a chunk of rays took longer than chunk_ms_max = " +
                std::to_string(plan.chunk_time_max.count()) +
                ": its rays meet too much of the scene, as they do from very far away or with "
                "directions too short to divide by; look at the rays, or raise the daemon's limit",
            0};
}

}  // namespace

TraceBuffers& TraceBuffers::of_this_thread() {
    thread_local TraceBuffers buffers;
    return buffers;
}

void TraceBuffers::copy(std::size_t first, std::size_t count, std::span<const Ray> from,
                        TraceBuffers& to) const {
    const std::size_t each = hits.size() / from.size();
    to.rays.clear();
    to.hits.clear();
    to.counts.clear();
    for (std::size_t row = first; row < first + count; ++row) {
        const std::size_t place = order.empty() ? row : order[row];
        to.rays.push_back(from[place]);
        const auto hit = hits.begin() + static_cast<std::ptrdiff_t>(place * each);
        to.hits.insert(to.hits.end(), hit, hit + static_cast<std::ptrdiff_t>(each));
        if (!counts.empty()) to.counts.push_back(counts[place]);
    }
    to.answered = static_cast<std::uint32_t>(count);
    to.traversal = traversal;
    to.on_cuda = on_cuda;
}

Reply<void> trace(const Plan& plan, std::span<const Ray> rays, const Stop& stop,
                  TraceBuffers& buffers, const PinholeRays* made) {
    const bool all = plan.query == query_all;
    const std::size_t count = rays.size();
    buffers.answered = static_cast<std::uint32_t>(count);
    buffers.order.clear();
    buffers.on_cuda = plan.on_cuda(buffers.fallback);
    buffers.outputs.resize(plan.variant->outputs().size());
    if (plan.untraced) {
        buffers.hits.clear();
        buffers.counters.assign(plan.counting ? count : 0, Counters{});
        for (std::vector<std::uint32_t>& column : buffers.outputs) column.assign(count, 0);
        return {};
    }
    buffers.hits.resize(all ? plan.hits_room : count * plan.hits_max);
    buffers.counts.resize(plan.csr() ? count : 0);
    buffers.flags.resize(all ? count : 0);
    buffers.counters.resize(plan.counting ? count : 0);
    std::vector<void*> outputs;
    for (std::vector<std::uint32_t>& column : buffers.outputs) {
        column.resize(count);
        outputs.push_back(column.data());
    }

    TraceCall call = plan.call();
    call.rays = rays.data();
    call.ray_count = buffers.answered;
    call.hits = buffers.hits.data();
    call.hit_counts = buffers.counts.empty() ? nullptr : buffers.counts.data();
    call.counters = buffers.counters.empty() ? nullptr : buffers.counters.data();
    call.outputs = outputs.empty() ? nullptr : outputs.data();
    call.hits_room = plan.hits_room;
    call.ray_flags = buffers.flags.data();
    call.rays_done = &buffers.answered;
    buffers.traversal = traversal_latency;  // of a GPU, one ray per thread
    if (buffers.on_cuda) return trace_on_cuda(plan, call, made, buffers);
    buffers.traversal = plan.tracer.choose(rays, *call.scene);
    const ChunkStop chunk(stop, plan.chunk_time_max);
    call.cancelled = is_requested;
    call.cancelled_context = &chunk;
    const TraceStatus status = plan.tracer.function(buffers.traversal)(&call);
    if (status == trace_cancelled) return tl::unexpected(cut_short(plan, stop));
    return check(status, plan);
}

void Tally::begin() {
    const Ticks now = std::max<Ticks>(1, (Clock::now() - accepted_).count());
    Ticks none = 0;
    first_.compare_exchange_strong(none, now);
}

void Tally::Counts::add_rays(std::span<const HitRecord> records,
                             std::span<const std::uint32_t> order, std::uint64_t first) {
    for (const HitRecord& ray : records) {
        misses += ray.hit == 0 ? 1 : 0;
        truncated += (ray.flags & hit_truncated) != 0 ? 1 : 0;
        invalid += (ray.flags & hit_invalid_ray) != 0 ? 1 : 0;
    }
    if (invalid == 0) return;
    std::size_t row = 0;
    while ((records[order.empty() ? row : order[row]].flags & hit_invalid_ray) == 0) ++row;
    first_invalid = first + row;
}

void Tally::add(const TraceBuffers& buffers, const Counts& counts) {
    traversals_ |= 1U << buffers.traversal;
    ++(buffers.on_cuda ? cuda_chunks_ : cpu_chunks_);
    if (!buffers.fallback.empty()) {
        const std::lock_guard lock(mutex_);
        ++fallen_back_;
        if (fallback_.empty()) fallback_ = buffers.fallback;
    }
    rays_ += counts.rays;
    hits_ += counts.hits;
    misses_ += counts.misses;
    truncated_ += counts.truncated;
    if (counts.invalid != 0) {
        invalid_ += counts.invalid;
        std::uint64_t first = first_invalid_;
        while (first > counts.first_invalid &&
               !first_invalid_.compare_exchange_weak(first, counts.first_invalid)) {
        }
    }
    const Ticks now = (Clock::now() - accepted_).count();
    Ticks last = last_;
    while (last < now && !last_.compare_exchange_weak(last, now)) {
    }
}

wire::DoneT Tally::done(const Plan& plan) const {
    const auto seconds = [](Ticks ticks) {
        return std::chrono::duration<double>(Clock::duration(ticks)).count();
    };
    wire::DoneT message;
    message.rays = rays_;
    message.hits = hits_;
    message.misses = misses_;
    message.truncated = truncated_;
    message.invalid = invalid_;
    if (message.invalid != 0) message.first_invalid = first_invalid_;
    message.seconds = seconds(last_ - first_);
    message.queued_seconds = seconds(first_);
    const std::uint32_t ran = traversals_;
    if (ran != 0) {
        message.traversal = std::has_single_bit(ran)
                                ? traversal_name(static_cast<Traversal>(std::countr_zero(ran)))
                                : "mixed";
    }
    message.worker = cuda_chunks_ == 0 ? "cpu" : cpu_chunks_ == 0 ? "cuda" : "mixed";
    message.target = cuda_chunks_ == 0 ? plan.variant->target : message.worker;
    const std::lock_guard lock(mutex_);
    if (fallen_back_ != 0) {
        message.notes.push_back(std::to_string(fallen_back_) + " of " +
                                std::to_string(cuda_chunks_ + cpu_chunks_) +
                                " chunks fell back to the CPU, with the same answers; the CUDA "
                                "worker: " +
                                fallback_);
    }
    return message;
}

}  // namespace raynest::server
