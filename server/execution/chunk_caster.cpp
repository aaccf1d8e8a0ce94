#include "server/execution/chunk_caster.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <vector>

namespace raynest::server {

bool ChunkCaster::closest(std::span<const Ray> rays, std::span<HitRecord> hits) {
    return cast(*plans_.closest, rays, hits, nullptr, nullptr);
}

bool ChunkCaster::closest(const PinholeRays& camera, std::span<const Ray> rays,
                          std::span<HitRecord> hits) {
    return cast(*plans_.closest, rays, hits, nullptr, &camera);
}

bool ChunkCaster::occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) {
    buffers_.resize(buffers_.occluders, rays.size());
    if (!cast(*plans_.any, rays, buffers_.occluders, nullptr, nullptr)) return false;
    std::ranges::transform(buffers_.occluders, answers.begin(), &HitRecord::hit);
    return true;
}

bool ChunkCaster::counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                          std::span<Counters> counters) {
    return cast(*plans_.counted, rays, hits, counters.data(), nullptr);
}

std::optional<double> ChunkCaster::timed(std::span<const Ray> rays, std::span<HitRecord> hits,
                                         std::span<std::uint32_t> nanoseconds,
                                         std::span<std::uint32_t> noise) {
    using Time = std::chrono::steady_clock;
    const auto run = [&](const Ray& ray, HitRecord& hit) -> std::optional<double> {
        // Kernels ask only within long rays.
        if (stop_.requested()) {
            failure_ = protocol::Error{Code::cancelled, "", 0};
            return std::nullopt;
        }
        const auto begin = Time::now();
        if (!cast(*plans_.timed, {&ray, 1}, {&hit, 1}, nullptr, nullptr)) return std::nullopt;
        return std::chrono::duration<double, std::nano>(Time::now() - begin).count();
    };
    if (rays.empty()) return 0;
    // The cost of a call and of the clock: a ray whose range is empty.
    Ray empty = rays.front();
    empty.tmin = 0;
    empty.tmax = 0;
    std::array<double, 65> calls{};
    HitRecord ignored;
    for (double& call : calls) {
        const auto time = run(empty, ignored);
        if (!time) return std::nullopt;
        call = *time;
    }
    std::ranges::nth_element(calls, calls.begin() + calls.size() / 2);
    const double call = calls[calls.size() / 2];

    // Runs of one ray lie apart, so that none finds all of its nodes in the cache.
    std::vector<std::array<float, ray_time_runs>> runs(rays.size());
    for (std::size_t round = 0; round < ray_time_runs; ++round)
        for (std::size_t i = 0; i < rays.size(); ++i) {
            const auto time = run(rays[i], hits[i]);
            if (!time) return std::nullopt;
            runs[i][round] = static_cast<float>(std::max(*time - call, 0.0));
        }
    double spread = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        std::ranges::sort(runs[i]);
        const float median = runs[i][ray_time_runs / 2];
        const float apart = runs[i][ray_time_runs * 3 / 4] - runs[i][ray_time_runs / 4];
        nanoseconds[i] = static_cast<std::uint32_t>(std::min(std::round(median), 4e9F));
        noise[i] = static_cast<std::uint32_t>(std::min(std::round(apart), 4e9F));
        if (median > 0) spread += static_cast<double>(apart / median);
    }
    return spread / static_cast<double>(rays.size());
}

bool ChunkCaster::observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                           const Observer& observer) {
    return cast(*plans_.observed, rays, hits, nullptr, nullptr, &observer);
}

bool ChunkCaster::cast(const Plan& plan, std::span<const Ray> rays, std::span<HitRecord> hits,
                       Counters* counters, const PinholeRays* camera, const Observer* observer) {
    Backend& backend = *plan.backends.order[backend_];
    const std::uint64_t most = backend.call_rays_max(plan);
    for (std::uint64_t done = 0; done < rays.size(); done += most) {
        const std::uint64_t count = std::min<std::uint64_t>(most, rays.size() - done);
        TraceCall call = plan.call();
        call.rays = rays.data() + done;
        call.ray_count = static_cast<std::uint32_t>(count);
        call.hits = hits.data() + done;
        call.counters = counters == nullptr ? nullptr : counters + done * plan.counter_sets();
        call.observer = observer;
        const std::vector<void*> outputs = buffers_.resize_outputs(plan, count);
        call.outputs = outputs.empty() ? nullptr : outputs.data();
        const bool whole = camera != nullptr && count == rays.size();
        const auto traced = backend.trace(
            plan, call, whole && backend.makes_camera_rays() ? camera : nullptr, stop_);
        if (!traced) {
            failure_ = traced.error();
            return false;
        }
        traversal_ = *traced;
    }
    return true;
}

}  // namespace raynest::server
