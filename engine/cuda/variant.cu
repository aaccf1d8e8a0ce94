// Compiles one intersector for GPUs. packs/pack.cmake compiles this file once per line of the list,
// as it does packs/variant.cpp.
#include "engine/cuda/check.h"
#include "engine/cuda/variant.h"

#include RAYNEST_INTERSECTOR_HEADER

#include <cstdint>

namespace raynest {
namespace {

using Isect = RAYNEST_INTERSECTOR_TYPE;
using Values = ParamsOf<Isect>::type;
static_assert(cuda::check_intersector<Isect, Declared{.boxes = RAYNEST_OVERRIDES_BOXES,
                                                      .primitives = RAYNEST_OVERRIDES_PRIMITIVES,
                                                      .instances = RAYNEST_OVERRIDES_INSTANCES}>());

template <Query kind>
__global__ void __launch_bounds__(cuda::block_rays)
    trace_kernel(const __grid_constant__ TraceCall call,
                 const __grid_constant__ cuda::CompressedTrees trees,
                 const __grid_constant__ Values values) {
    const std::uint32_t i = blockIdx.x * cuda::block_rays + threadIdx.x;
    if (i < call.ray_count) cuda::trace_ray<Isect, kind>(call, trees, values, i);
}

struct Kernels {
    template <Query kind>
    static const void* of() {
        return reinterpret_cast<const void*>(&trace_kernel<kind>);
    }
};

}  // namespace

const PackVariant& RAYNEST_INTERSECTOR_FUNCTION() noexcept {
    static const PackVariant variant = cuda::make_variant<Isect, Kernels>(RAYNEST_INTERSECTOR_NAME);
    return variant;
}

}  // namespace raynest
