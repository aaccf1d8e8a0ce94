// One intersector compiled for GPUs: a kernel per query, and the host functions of the table that
// launch them. packs/pack.cmake compiles this file once per line of the list, as it does
// packs/variant.cpp.
//
// A watertight kernel is the fast one, as on the CPU; counters are the CPU's (CONTRACT.md §4).
#include "engine/cuda/check.h"
#include "engine/cuda/launch.h"
#include "engine/cuda/trace.h"

#include RAYNEST_INTERSECTOR_HEADER

#include <cstdint>

namespace raynest {
namespace {

using Isect = RAYNEST_INTERSECTOR_TYPE;
using Values = ParamsOf<Isect>::type;
static_assert(cuda::check_intersector<Isect, Declared{RAYNEST_INTERSECTOR_OVERRIDES}>());

template <Query kind>
__global__ void __launch_bounds__(cuda::block_rays)
    trace_kernel(const __grid_constant__ TraceCall call,
                 const __grid_constant__ cuda::CompressedTrees trees,
                 const __grid_constant__ Values values) {
    const std::uint32_t i = blockIdx.x * cuda::block_rays + threadIdx.x;
    if (i < call.ray_count) cuda::trace_ray<Isect, kind>(call, trees, values, i);
}

template <Query kind>
TraceStatus trace(const TraceCall* call) noexcept {
    Values values = read_params<Isect>(*call);
    return cuda::launch(*call, kind, reinterpret_cast<const void*>(&trace_kernel<kind>), &values);
}

template <Query kind>
void add_query(PackVariant& variant) {
    for (auto& traversals : variant.trace) traversals[traversal_latency][kind][0] = trace<kind>;
}

}  // namespace

const PackVariant& RAYNEST_INTERSECTOR_FUNCTION() noexcept {
    static const PackVariant variant = [] {
        PackVariant v = describe_variant<Isect>(RAYNEST_INTERSECTOR_NAME);
        if constexpr (cuda::runs_here<Isect>) {
            add_query<query_closest>(v);
            add_query<query_any>(v);
            add_query<query_multi>(v);
        }
        return v;
    }();
    return variant;
}

}  // namespace raynest
