#include "engine/cuda/launch.h"
#include "engine/cuda/make_rays.h"

namespace raynest::cuda {
namespace {

__global__ void __launch_bounds__(block_rays)
    make_rays(const __grid_constant__ PinholeRays made, Ray* rays, std::uint32_t count) {
    const std::uint32_t i = blockIdx.x * block_rays + threadIdx.x;
    if (i < count) make_ray(made, rays, i);
}

}  // namespace

const void* make_rays_kernel() noexcept {
    return reinterpret_cast<const void*>(&make_rays);
}

}  // namespace raynest::cuda
