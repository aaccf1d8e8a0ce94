#include "engine/inspection/path_recorder.h"

namespace raynest {

bool PathRecorder::closest(std::span<const Ray> rays, std::span<HitRecord> hits) {
    if (!base_.closest(rays, hits)) return false;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        PathRay ray{PathRayKind::camera, last_, 0, rays[i], false, hits[i]};
        if (last_ != no_id) {
            ray.kind = PathRayKind::bounce;
            ray.bounce = rays_[last_].bounce + 1;
        }
        last_ = static_cast<std::uint32_t>(rays_.size());
        rays_.push_back(ray);
    }
    return true;
}

bool PathRecorder::occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) {
    if (!base_.occluded(rays, answers)) return false;
    // Occlusion has no hit: ask again for what blocks the light.
    std::vector<HitRecord> blockers(rays.size());
    if (!base_.closest(rays, blockers)) return false;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        // Integrators send invalid rays where there is nothing to ask.
        if (!is_valid(rays[i])) continue;
        const std::uint32_t bounce = last_ == no_id ? 0 : rays_[last_].bounce + 1;
        rays_.push_back({PathRayKind::shadow, last_, bounce, rays[i], answers[i] != 0,
                         answers[i] != 0 ? blockers[i] : HitRecord{}});
    }
    return true;
}

bool PathRecorder::counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                           std::span<Counters> counters) {
    return base_.counted(rays, hits, counters);
}

bool PathRecorder::observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                            const Observer& observer) {
    return base_.observed(rays, hits, observer);
}

}  // namespace raynest
