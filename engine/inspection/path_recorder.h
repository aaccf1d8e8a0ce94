// The rays of one sample of a lit picture, for people.
//
//   integrator ──► PathRecorder ──► the job's own RayCaster
//
// An integrator asks for a closest hit where a path goes on, and for occlusion where it looks at a
// light. So the order of its questions is the path.
#pragma once

#include "engine/integrators/ray_caster.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

enum class PathRayKind : std::uint8_t { camera, bounce, shadow };

struct PathRay {
    PathRayKind kind = PathRayKind::camera;
    std::uint32_t parent = no_id;  ///< index of the ray on whose hit it begins
    std::uint32_t bounce = 0;      ///< surfaces that the path met before
    Ray ray;
    bool blocked = false;  ///< for a shadow ray: the light is hidden
    HitRecord hit;         ///< the nearest surface; of a shadow ray one that blocks it
};

/// Passes questions about one sample on, and keeps the rays and their answers.
class PathRecorder final : public RayCaster {
public:
    explicit PathRecorder(RayCaster& base) : base_(base) {}

    [[nodiscard]] const std::vector<PathRay>& rays() const { return rays_; }

    bool closest(std::span<const Ray> rays, std::span<HitRecord> hits) override;
    using RayCaster::closest;
    bool occluded(std::span<const Ray> rays, std::span<std::uint8_t> answers) override;
    bool counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                 std::span<Counters> counters) override;
    bool observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                  const Observer& observer) override;

private:
    RayCaster& base_;
    std::vector<PathRay> rays_;
    std::uint32_t last_ = no_id;  ///< the ray that brought the path where it is
};

}  // namespace raynest
