// The questions of an integrator about the scene. It sees no worker: a thread, a GPU and another
// machine give the same answers.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/geometry/pinhole.h"
#include "engine/geometry/ray.h"
#include "engine/packs/observer.h"

#include <cstdint>
#include <optional>
#include <span>

namespace raynest {

/// Runs of each ray that timed() takes the median of.
inline constexpr std::size_t ray_time_runs = 5;

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
    /// The nearest hit of each ray by the single-ray traversal, one ray after the other, and how many
    /// nanoseconds it took: the median of `ray_time_runs` runs over all rays, minus the time of a ray
    /// that hits nothing. `noise` gets by how much the runs of a ray differ: the distance of their
    /// quartiles. Returns its mean over all rays, as a share of the median; nothing where there are no
    /// answers, as from casters that measure no time.
    [[nodiscard]] virtual std::optional<double> timed(std::span<const Ray> /*rays*/,
                                                      std::span<HitRecord> /*hits*/,
                                                      std::span<std::uint32_t> /*nanoseconds*/,
                                                      std::span<std::uint32_t> /*noise*/) {
        return std::nullopt;
    }
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
