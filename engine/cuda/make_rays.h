// Makes camera rays on the device, so that no rays are copied.
#pragma once

#include "engine/geometry/pinhole.h"

#include <cstdint>

namespace raynest::cuda {

/// Makes ray `i`, in a thread of make_rays_kernel().
RAYNEST_INLINE void make_ray(const PinholeRays& made, Ray* rays, std::uint32_t i) {
    rays[i] = made.ray(i);
}

/// Returns kernel(PinholeRays, Ray* rays, std::uint32_t count), which makes the first `count` rays.
[[nodiscard]] const void* make_rays_kernel() noexcept;

}  // namespace raynest::cuda
