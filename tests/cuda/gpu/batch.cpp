#include "tests/cuda/gpu/batch.h"

#include "tests/bench/clock.h"

#include <algorithm>
#include <cstring>

namespace raynest::bench {

Batch::Batch(std::span<const Ray> from, std::uint32_t count)
    : count_(count),
      rays_(count * sizeof(Ray)),
      hits_(std::size_t{count} * most_hits * sizeof(HitRecord)),
      hit_counts_(count * sizeof(std::uint32_t)) {
    const std::size_t stride = std::max<std::size_t>(1, from.size() / count);
    for (std::size_t i = 0; i < count; ++i) {
        const Ray& ray = from[i * stride % from.size()];
        std::memcpy(rays_.data() + i * sizeof(Ray), &ray, sizeof ray);
    }
    forget_answers();
}

std::string Batch::pin(const OpenDevice& device) {
    std::string refused;
    for (Pages* const memory : {&rays_, &hits_, &hit_counts_}) {
        if (refused.empty()) refused = device.pin(memory->data(), memory->size());
    }
    return refused;
}

TraceCall Batch::call(const Question& question, std::uint32_t first, std::uint32_t count) {
    const std::size_t first_hit = std::size_t{first} * question.hits_max;
    TraceCall call{};
    call.rays = reinterpret_cast<const Ray*>(rays_.data()) + first;
    call.ray_count = count;
    call.hits_max = question.hits_max;
    call.mask = 0xFFFFFFFFU;
    call.hits = reinterpret_cast<HitRecord*>(hits_.data()) + first_hit;
    call.hit_counts = reinterpret_cast<std::uint32_t*>(hit_counts_.data()) + first;
    return call;
}

std::span<const HitRecord> Batch::answer(const Question& question, std::uint32_t ray) const {
    const auto* hits = reinterpret_cast<const HitRecord*>(hits_.data());
    const auto* counts = reinterpret_cast<const std::uint32_t*>(hit_counts_.data());
    const std::uint32_t filled =
        question.query == query_multi ? std::min(counts[ray], question.hits_max) : 1;
    return {hits + std::size_t{ray} * question.hits_max, filled};
}

void Batch::forget_answers() {
    for (Pages* const memory : {&hits_, &hit_counts_}) {
        std::memset(memory->data(), 0xA5, memory->size());
    }
}

Pass run_pass(const Route& route, const Question& question, Batch& batch) {
    Pass pass{0, 0};
    const double begin = seconds_of(CLOCK_MONOTONIC);
    std::size_t started = 0, finished = 0;
    const auto finish_one = [&] {
        pass.kernel_seconds += route.device->finish(route.slots[finished++ % route.slots.size()]);
    };
    for (std::uint32_t first = 0; first < batch.count(); first += route.chunk) {
        if (started - finished == route.slots.size()) finish_one();
        const std::uint32_t rays = std::min(route.chunk, batch.count() - first);
        PinholeRays made;
        if (route.made != nullptr) {
            made = *route.made;
            made.first += first;
        }
        route.device->start(route.slots[started++ % route.slots.size()], *route.scene, route.kernel,
                            batch.call(question, first, rays),
                            route.made != nullptr ? &made : nullptr);
    }
    while (finished < started) finish_one();
    pass.wall_seconds = seconds_of(CLOCK_MONOTONIC) - begin;
    return pass;
}

}  // namespace raynest::bench
