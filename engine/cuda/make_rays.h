// Camera rays made where they are traced, so that none travel.
#pragma once

#include "engine/geometry/pinhole.h"

#include <cstdint>

namespace raynest::cuda {

/// What a thread of make_rays_kernel() does.
RAYNEST_INLINE void make_ray(const PinholeRays& made, Ray* rays, std::uint32_t i) {
    rays[i] = made.ray(i);
}

/// kernel(PinholeRays, Ray* rays, std::uint32_t count): the first `count` of them.
[[nodiscard]] const void* make_rays_kernel() noexcept;

}  // namespace raynest::cuda
