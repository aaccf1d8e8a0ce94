#include "server/execution/statistics.h"

#include <algorithm>
#include <bit>
#include <chrono>

namespace raynest::server {

void JobStatistics::begin() {
    if (first_ != 0) return;
    const Ticks now = std::max<Ticks>(1, (Clock::now() - accepted_).count());
    Ticks none = 0;
    first_.compare_exchange_strong(none, now);
}

void JobStatistics::Counts::add_rays(std::span<const HitRecord> records,
                                     std::span<const std::uint32_t> order, std::uint64_t first) {
    const auto add = [this](const HitRecord& ray) {
        misses += ray.hit == 0 ? 1 : 0;
        truncated += (ray.flags & hit_truncated) != 0 ? 1 : 0;
        invalid += (ray.flags & hit_invalid_ray) != 0 ? 1 : 0;
    };
    if (!order.empty() && order.size() != records.size())
        for (const std::uint32_t place : order) add(records[place]);
    else
        for (const HitRecord& ray : records) add(ray);
    if (invalid == 0) return;
    std::size_t row = 0;
    while ((records[order.empty() ? row : order[row]].flags & hit_invalid_ray) == 0) ++row;
    first_invalid = first + row;
}

void JobStatistics::add(std::size_t backend, std::uint32_t traversals, const Counts& counts) {
    traversals_ |= traversals;
    ++chunks_[backend];
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

wire::DoneT JobStatistics::done(const Plan& plan, const ChunkQueue& queue) const {
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
    // A job may end without an answered chunk, as a picture whose samples are all there.
    message.seconds = seconds(std::max<Ticks>(last_, first_) - first_);
    message.queued_seconds = seconds(first_);
    const std::uint32_t ran = traversals_;
    if (ran != 0) {
        message.traversal = std::has_single_bit(ran)
                                ? traversal_name(static_cast<Traversal>(std::countr_zero(ran)))
                                : "mixed";
    }
    std::uint64_t chunks = 0;
    std::size_t answering = 0;  // number of backends that answered chunks
    const Backend* backend = plan.backends.order.back();
    for (std::size_t i = 0; i < plan.backends.order.size(); ++i) {
        if (chunks_[i] == 0) continue;
        chunks += chunks_[i];
        ++answering;
        backend = plan.backends.order[i];
    }
    message.worker = answering > 1 ? "mixed" : backend->name();
    message.target = answering > 1 ? "mixed" : backend->target(plan);
    if (const std::uint64_t redealt = chunks - chunks_[0]; redealt != 0) {
        message.notes.push_back(std::to_string(redealt) + " of " + std::to_string(chunks) +
                                " chunks fell back to the CPU, with the same answers; " +
                                queue.redealt_reason());
    }
    return message;
}

}  // namespace raynest::server
