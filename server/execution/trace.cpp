#include "server/execution/trace.h"

#include <algorithm>
#include <functional>
#include <iterator>
#include <utility>

namespace raynest::server {

std::uint64_t TraceBuffers::bytes() const {
    const auto bytes_of = [](const auto& vector) { return vector.size() * sizeof(vector.front()); };
    std::uint64_t sum = bytes_of(rays) + bytes_of(sent) + bytes_of(hits) + bytes_of(order) +
                        bytes_of(counts) + bytes_of(flags) + bytes_of(counters) +
                        bytes_of(occluders) + bytes_of(masks);
    for (const auto& column : outputs) sum += bytes_of(column);
    if (of_masks != nullptr) sum += of_masks->bytes();
    return sum;
}

std::uint64_t TraceBuffers::held_bytes() const {
    return lease.bytes() + (of_masks != nullptr ? of_masks->held_bytes() : 0);
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

std::vector<std::unique_ptr<TraceBuffers>> TraceBufferPool::trim() {
    const std::lock_guard lock(mutex_);
    const auto unused = std::ranges::stable_partition(idle_, [](const auto& buffers) {
        return 2 * std::exchange(buffers->used_bytes, 0) > buffers->held_bytes();
    });
    std::vector<std::unique_ptr<TraceBuffers>> trimmed(std::move_iterator(unused.begin()),
                                                       std::move_iterator(unused.end()));
    idle_.erase(unused.begin(), unused.end());
    count_ -= trimmed.size();
    return trimmed;
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

namespace {

/// The rays that a call of a backend has answered, and how.
struct Ran {
    std::uint32_t rays = 0;
    Traversal traversal = traversal_single;
};

void resize_answers(const Plan& plan, std::size_t count, TraceBuffers& buffers) {
    const bool all = plan.query == query_all;
    const std::size_t hits = all ? plan.hits_room : count * plan.hits_max;
    buffers.resize(buffers.hits, plan.untraced ? 0 : hits);
    buffers.resize(buffers.counts, plan.csr() ? count : 0);
    buffers.resize(buffers.flags, all ? count : 0);
    buffers.resize(buffers.counters, count * plan.counter_sets());
    buffers.resize_outputs(plan, count);
}

/// Traces `rays`, the answers of which begin at row `first` of `buffers`; for kind all, `used` hit
/// records of them are taken.
Traced<Ran> call_backend(const Plan& plan, std::size_t backend, std::uint32_t mask,
                         std::span<const Ray> rays, std::size_t first, std::uint64_t used,
                         const Stop& stop, TraceBuffers& buffers, const PinholeRays* camera) {
    const bool all = plan.query == query_all;
    const auto from = [&](auto& vector, std::size_t at) {
        return vector.empty() ? nullptr : vector.data() + at;
    };
    std::vector<void*> outputs;
    for (std::vector<std::uint32_t>& column : buffers.outputs)
        outputs.push_back(column.data() + first);
    Ran ran{static_cast<std::uint32_t>(rays.size())};
    TraceCall call = plan.call();
    call.mask = mask;
    call.rays = rays.data();
    call.ray_count = ran.rays;
    call.hits = buffers.hits.data() + (all ? used : first * plan.hits_max);
    call.hit_counts = from(buffers.counts, first);
    call.counters = from(buffers.counters, first * plan.counter_sets());
    call.outputs = outputs.empty() ? nullptr : outputs.data();
    call.hits_room = all ? buffers.hits.size() - used : 0;
    call.ray_flags = from(buffers.flags, first);
    call.rays_done = &ran.rays;
    const auto traced = plan.backends.order[backend]->trace(plan, call, camera, stop);
    if (!traced) return tl::unexpected(traced.error());
    ran.traversal = *traced;
    return ran;
}

/// The first `answered` of the rays, with what `buffers` has for them.
TracedRays answered_rays(const Plan& plan, std::size_t backend, std::span<const Ray> rays,
                         std::size_t answered, TraceBuffers& buffers, std::uint32_t traversals) {
    TracedRays result{rays.first(answered),
                      buffers.hits,
                      {},
                      std::span(buffers.counts).first(plan.csr() ? answered : 0),
                      buffers.flags,
                      buffers.counters,
                      buffers.outputs};
    result.traversals = traversals;
    result.backend = backend;
    return result;
}

/// The places of rays in an order in which those of one mask follow each other.
struct ByMask {
    struct Group {
        std::uint32_t mask;
        std::size_t count;
    };
    std::vector<Group> groups;
    std::span<const std::uint32_t> order;  ///< in buffers.order: index of each ray
};

ByMask by_mask(std::span<const std::uint32_t> masks, TraceBuffers& buffers) {
    ByMask sorted;
    std::vector<ByMask::Group>& groups = sorted.groups;
    auto group_of = [&, last = std::size_t{0}](std::uint32_t mask) mutable {
        if (last < groups.size() && groups[last].mask == mask) return last;
        for (last = 0; last < groups.size(); ++last)
            if (groups[last].mask == mask) return last;
        groups.push_back({mask, 0});
        return last;
    };
    for (const std::uint32_t mask : masks) ++groups[group_of(mask)].count;
    std::vector<std::size_t> next;
    std::size_t end = 0;
    for (const ByMask::Group& group : groups) {
        next.push_back(end);
        end += group.count;
    }
    buffers.resize(buffers.order, masks.size());
    for (std::size_t i = 0; i < masks.size(); ++i)
        buffers.order[next[group_of(masks[i])]++] = static_cast<std::uint32_t>(i);
    sorted.order = buffers.order;
    return sorted;
}

/// Traces each run of rays with one mask: the hits of kind all lie in the order of their rays.
Traced<TracedRays> trace_runs(const Plan& plan, std::size_t backend, std::span<const Ray> rays,
                              std::span<const std::uint32_t> masks, const Stop& stop,
                              TraceBuffers& buffers) {
    std::size_t done = 0;
    std::uint64_t used = 0;
    std::uint32_t traversals = 0;
    // A call needs room for twice the budget of a ray, the last one too.
    buffers.resize(buffers.hits, plan.hits_room + 2ULL * plan.hits_max);
    while (done < rays.size() && used <= plan.hits_room) {
        const std::uint32_t mask = masks[done];
        const auto behind = std::find_if(masks.begin() + static_cast<std::ptrdiff_t>(done),
                                         masks.end(), [&](auto other) { return other != mask; });
        const auto count = static_cast<std::size_t>(behind - masks.begin()) - done;
        const auto ran = call_backend(plan, backend, plan.mask & mask, rays.subspan(done, count),
                                      done, used, stop, buffers, nullptr);
        if (!ran) return tl::unexpected(ran.error());
        traversals |= 1U << ran->traversal;
        for (std::size_t i = 0; i < ran->rays; ++i) used += buffers.counts[done + i];
        done += ran->rays;
        if (ran->rays < count) break;
    }
    return answered_rays(plan, backend, rays, done, buffers, traversals);
}

/// Copies blocks of `each` values to the places that `order` gives them.
template <class T>
void put_back(const std::vector<T>& from, std::vector<T>& to, std::size_t each,
              std::span<const std::uint32_t> order) {
    if (from.empty()) return;
    for (std::size_t i = 0; i < order.size(); ++i)
        std::copy_n(from.data() + i * each, each, to.data() + order[i] * each);
}

Traced<TracedRays> trace_alike(const Plan& plan, std::size_t backend, std::uint32_t mask,
                               std::span<const Ray> rays, const Stop& stop, TraceBuffers& buffers,
                               const PinholeRays* camera) {
    resize_answers(plan, rays.size(), buffers);
    if (plan.untraced) {
        std::fill(buffers.counters.begin(), buffers.counters.end(), Counters{});
        for (std::vector<std::uint32_t>& column : buffers.outputs)
            std::fill(column.begin(), column.end(), 0U);
        return answered_rays(plan, backend, rays, rays.size(), buffers, 1U << traversal_single);
    }
    const auto ran = call_backend(plan, backend, mask, rays, 0, 0, stop, buffers, camera);
    if (!ran) return tl::unexpected(ran.error());
    return answered_rays(plan, backend, rays, ran->rays, buffers, 1U << ran->traversal);
}

}  // namespace

Traced<TracedRays> trace_rays(const Plan& plan, std::size_t backend, std::span<const Ray> rays,
                              const Stop& stop, TraceBuffers& buffers, const PinholeRays* camera) {
    return trace_alike(plan, backend, plan.mask, rays, stop, buffers, camera);
}

Traced<TracedRays> trace_masked_rays(const Plan& plan, std::size_t backend,
                                     std::span<const Ray> rays,
                                     std::span<const std::uint32_t> masks, const Stop& stop,
                                     TraceBuffers& buffers) {
    const bool alike = std::ranges::adjacent_find(masks, std::not_equal_to()) == masks.end();
    if (alike || plan.untraced)
        return trace_alike(plan, backend, plan.mask & masks.front(), rays, stop, buffers, nullptr);
    resize_answers(plan, rays.size(), buffers);
    if (plan.query == query_all) return trace_runs(plan, backend, rays, masks, stop, buffers);
    const ByMask sorted = by_mask(masks, buffers);
    if (buffers.of_masks == nullptr)
        buffers.of_masks = std::make_unique<TraceBuffers>(buffers.budget);
    TraceBuffers& part = *buffers.of_masks;
    resize_answers(plan, rays.size(), part);
    part.resize(part.rays, rays.size());
    for (std::size_t i = 0; i < rays.size(); ++i) part.rays[i] = rays[sorted.order[i]];
    std::size_t first = 0;
    std::uint32_t traversals = 0;
    for (const ByMask::Group& group : sorted.groups) {
        const auto ran = call_backend(plan, backend, plan.mask & group.mask,
                                      std::span(part.rays).subspan(first, group.count), first, 0,
                                      stop, part, nullptr);
        if (!ran) return tl::unexpected(ran.error());
        traversals |= 1U << ran->traversal;
        first += group.count;
    }
    put_back(part.hits, buffers.hits, plan.hits_max, sorted.order);
    put_back(part.counts, buffers.counts, 1, sorted.order);
    put_back(part.counters, buffers.counters, plan.counter_sets(), sorted.order);
    for (std::size_t i = 0; i < part.outputs.size(); ++i)
        put_back(part.outputs[i], buffers.outputs[i], 1, sorted.order);
    return answered_rays(plan, backend, rays, rays.size(), buffers, traversals);
}

}  // namespace raynest::server
