#include "server/execution/trace.h"

#include <algorithm>
#include <utility>

namespace raynest::server {

std::uint64_t TraceBuffers::bytes() const {
    const auto bytes_of = [](const auto& vector) { return vector.size() * sizeof(vector.front()); };
    std::uint64_t sum = bytes_of(rays) + bytes_of(sent) + bytes_of(hits) + bytes_of(order) +
                        bytes_of(counts) + bytes_of(flags) + bytes_of(counters) +
                        bytes_of(occluders);
    for (const auto& column : outputs) sum += bytes_of(column);
    return sum;
}

std::vector<void*> TraceBuffers::resize_outputs(const Plan& plan, std::size_t count) {
    outputs.resize(plan.variant->outputs().size());
    std::vector<void*> columns;
    for (std::vector<std::uint32_t>& column : outputs) {
        resize(column, count);
        columns.push_back(column.data());
    }
    return columns;
}

TraceBufferPool::Use TraceBufferPool::take() {
    const std::lock_guard lock(mutex_);
    if (!idle_.empty()) {
        Use last(idle_.back().release(), {this});
        idle_.pop_back();
        return last;
    }
    idle_.reserve(count_ + 1);  // so that give_back() cannot throw
    Use fresh(new TraceBuffers(budget_), {this});
    ++count_;
    return fresh;
}

void TraceBufferPool::give_back(TraceBuffers* buffers) noexcept {
    buffers->used_bytes = std::max(buffers->used_bytes, buffers->bytes());
    const std::lock_guard lock(mutex_);
    idle_.emplace_back(buffers);
}

void TraceBufferPool::trim() {
    const std::lock_guard lock(mutex_);
    count_ -= std::erase_if(idle_, [](const std::unique_ptr<TraceBuffers>& buffers) {
        return 2 * std::exchange(buffers->used_bytes, 0) <= buffers->lease.bytes();
    });
}

TracedRays TracedRays::slice(std::size_t from, std::size_t count) const {
    TracedRays part = *this;
    part.first = first + from;
    const auto cut = [&](auto& span, std::size_t each) {
        if (!span.empty()) span = span.subspan(from * each, count * each);
    };
    cut(part.order, 1);
    if (!order.empty()) return part;  // `order` indexes all rays and hits: do not cut those
    // Leave packed hits (kind all) uncut: such a slice begins with the first row.
    if (flags.empty() && !rays.empty()) cut(part.hits, hits.size() / rays.size());
    if (!rays.empty()) cut(part.counters, counters.size() / rays.size());
    cut(part.rays, 1);
    cut(part.counts, 1);
    cut(part.flags, 1);
    return part;
}

Traced<TracedRays> trace_rays(const Plan& plan, std::size_t backend, std::span<const Ray> rays,
                              const Stop& stop, TraceBuffers& buffers, const PinholeRays* camera) {
    const bool all = plan.query == query_all;
    const std::size_t count = rays.size();
    const std::size_t hits = all ? plan.hits_room : count * plan.hits_max;
    buffers.resize(buffers.hits, plan.untraced ? 0 : hits);
    buffers.resize(buffers.counts, plan.csr() ? count : 0);
    buffers.resize(buffers.flags, all ? count : 0);
    buffers.resize(buffers.counters, count * plan.counter_sets());
    const std::vector<void*> outputs = buffers.resize_outputs(plan, count);

    auto answered = static_cast<std::uint32_t>(count);
    Traversal traversal = traversal_single;
    if (plan.untraced) {
        std::fill(buffers.counters.begin(), buffers.counters.end(), Counters{});
        for (std::vector<std::uint32_t>& column : buffers.outputs)
            std::fill(column.begin(), column.end(), 0U);
    } else {
        TraceCall call = plan.call();
        call.rays = rays.data();
        call.ray_count = answered;
        call.hits = buffers.hits.data();
        call.hit_counts = buffers.counts.empty() ? nullptr : buffers.counts.data();
        call.counters = buffers.counters.empty() ? nullptr : buffers.counters.data();
        call.outputs = outputs.empty() ? nullptr : outputs.data();
        call.hits_room = plan.hits_room;
        call.ray_flags = buffers.flags.data();
        call.rays_done = &answered;
        const auto traced = plan.worker.order[backend]->trace(plan, call, camera, stop);
        if (!traced) return tl::unexpected(traced.error());
        traversal = *traced;
    }
    TracedRays result{rays.first(answered),
                      buffers.hits,
                      {},
                      std::span(buffers.counts).first(plan.csr() ? answered : 0),
                      buffers.flags,
                      buffers.counters,
                      buffers.outputs};
    result.traversal = traversal;
    result.backend = backend;
    return result;
}

}  // namespace raynest::server
