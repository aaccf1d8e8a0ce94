// The questions of an integrator about the scene. It sees no worker: a thread, a GPU and another
// machine give the same answers.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/pinhole.h"
#include "engine/geometry/ray.h"
#include "engine/packs/observer.h"

#include <cstdint>
#include <span>

namespace raynest {

/// Each function answers all `rays`, in order, in the array beside them. False: there are no
/// answers, and the integrator returns at once; its caller knows why.
class RayCaster {
public:
    /// The nearest hit of each ray, or a miss.
    [[nodiscard]] virtual bool closest(std::span<const Ray> rays, std::span<HitRecord> hits) = 0;
    /// The same for rays of a camera, which a GPU makes for itself.
    [[nodiscard]] virtual bool closest(const PinholeRays& /*camera*/, std::span<const Ray> rays,
                                       std::span<HitRecord> hits) {
        return closest(rays, hits);
    }
    /// 1 where a ray meets anything within its range, else 0.
    [[nodiscard]] virtual bool occluded(std::span<const Ray> rays,
                                        std::span<std::uint8_t> answers) = 0;
    /// The nearest hit of each ray, and what finding it cost by the single-ray traversal.
    [[nodiscard]] virtual bool counted(std::span<const Ray> rays, std::span<HitRecord> hits,
                                       std::span<Counters> counters) = 0;
    /// The nearest hit of each ray, found by the single-ray traversal, which tells the observer.
    [[nodiscard]] virtual bool observed(std::span<const Ray> rays, std::span<HitRecord> hits,
                                        const Observer& observer) = 0;

protected:
    RayCaster() = default;
    RayCaster(const RayCaster&) = default;
    RayCaster& operator=(const RayCaster&) = default;
    ~RayCaster() = default;
};

}  // namespace raynest
