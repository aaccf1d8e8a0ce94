// The kernel of cuda/make_rays.h for the fake runtime.
#include "engine/cuda/make_rays.h"

#include "tests/cuda/fake_runtime/cuda_runtime_api.h"

namespace raynest::cuda {
namespace {

void make_rays(void** arguments, unsigned threads) {
    const auto& made = *static_cast<const PinholeRays*>(arguments[0]);
    Ray* const rays = *static_cast<Ray**>(arguments[1]);
    const auto count = *static_cast<const std::uint32_t*>(arguments[2]);
    for (std::uint32_t i = 0; i < threads; ++i) {
        if (i < count) make_ray(made, rays, i);
    }
}

}  // namespace

const void* make_rays_kernel() noexcept {
    return reinterpret_cast<const void*>(static_cast<FakeKernel>(make_rays));
}

}  // namespace raynest::cuda
