// One intersector of the cuda target on the host: the functions that a GPU's threads run, in a loop
// over the rays, behind the cuda pack's own launch code and a fake of the CUDA runtime. A pack of
// these passes the whole of conformance, so a machine without a GPU checks the traversal, the
// compressed trees, the hooks and the copies, bit for bit. It does not check that nvcc's arithmetic
// equals g++'s. tests/cuda/CMakeLists.txt compiles this file as packs/variant.cpp is compiled. The
// table is that of a GPU: without a reference.
#include "engine/cuda/variant.h"

#include "engine/cuda/check.h"
#include "engine/cuda/compress.h"
#include "tests/cuda/fake_runtime/cuda_runtime_api.h"

#include RAYNEST_INTERSECTOR_HEADER

#include <cstdint>

namespace raynest {
namespace {

using Isect = RAYNEST_INTERSECTOR_TYPE;
static_assert(cuda::check_intersector<Isect, Declared{.boxes = RAYNEST_OVERRIDES_BOXES,
                                                      .primitives = RAYNEST_OVERRIDES_PRIMITIVES,
                                                      .instances = RAYNEST_OVERRIDES_INSTANCES}>());

template <Query kind>
void trace_kernel(void** arguments, unsigned threads) {
    const auto& call = *static_cast<const TraceCall*>(arguments[0]);
    const auto& trees = *static_cast<const cuda::CompressedTrees*>(arguments[1]);
    const auto& values = *static_cast<const ParamsOf<Isect>::type*>(arguments[2]);
    for (std::uint32_t i = 0; i < threads; ++i) {
        if (i < call.ray_count) cuda::trace_ray<Isect, kind>(call, trees, values, i);
    }
}

struct Kernels {
    template <Query kind>
    static const void* of() {
        return reinterpret_cast<const void*>(static_cast<FakeKernel>(trace_kernel<kind>));
    }
};

}  // namespace

const PackVariant& RAYNEST_INTERSECTOR_FUNCTION() noexcept {
    static const PackVariant variant = cuda::make_variant<Isect, Kernels>(RAYNEST_INTERSECTOR_NAME);
    return variant;
}

}  // namespace raynest
