#include "server/execution/chunk_caster.h"

#include <algorithm>

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

bool ChunkCaster::observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                           const Observer& observer) {
    return cast(*plans_.observed, rays, hits, nullptr, nullptr, &observer);
}

bool ChunkCaster::cast(const Plan& plan, std::span<const Ray> rays, std::span<HitRecord> hits,
                       Counters* counters, const PinholeRays* camera, const Observer* observer) {
    Backend& backend = *plan.worker.order[backend_];
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
