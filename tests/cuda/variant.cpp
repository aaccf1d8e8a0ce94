// One intersector of the cuda target on the host: the functions that a GPU's threads run, in a loop
// over the rays, behind the cuda pack's own launch code and a fake of the CUDA runtime. A pack of
// these goes through the whole of conformance, so a machine without a GPU knows that the walk, the
// compressed trees, the hooks and the way to the device and back are right, bit for bit; it does
// not know that nvcc's arithmetic is g++'s. tests/cuda/CMakeLists.txt compiles this file as
// packs/variant.cpp is.
//
// `latency` stands for the compressed trees, `batch` for their binary twin. RAYNEST_FAKE_CUDA_BARE
// in the environment leaves the table as a GPU's is: without the twin, and without a reference.
#include "engine/cuda/variant.h"

#include "engine/cuda/check.h"
#include "engine/cuda/compress.h"
#include "engine/queries/reference.h"
#include "tests/cuda/binary_trees.h"
#include "tests/cuda/fake_runtime/cuda_runtime_api.h"

#include RAYNEST_INTERSECTOR_HEADER

#include <cstdint>
#include <cstdlib>

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

template <Query kind>
TraceStatus trace_binary(const TraceCall* call) noexcept {
    if (!cuda::compress(*call->scene)) return trace_too_deep;
    const cuda::BinaryTrees trees(*call->scene);
    const auto values = read_params<Isect>(*call);
    for (std::uint32_t i = 0; i < call->ray_count; ++i) {
        cuda::trace_ray<Isect, kind>(*call, trees, values, i);
    }
    return trace_ok;
}

template <Query kind>
TraceStatus trace_everything(const TraceCall* call) noexcept {
    const Feed<kind> feed{*call, 0};
    const Bvh root{call->scene, call->scene->root};
    Isect isect = make_intersector<Isect>(*call->scene, read_params<Isect>(*call));
    for (std::uint32_t i = 0; i < call->ray_count; ++i) {
        RayView view;
        if (!feed.begin(i, view)) continue;
        auto query = feed.query(i);
        visit_everything(view, root, isect, query);
        feed.end(i, query);
    }
    return trace_ok;
}

template <Query kind>
void add_query(PackVariant& variant) {
    for (auto& traversals : variant.trace) {
        traversals[traversal_batch][kind][0] = trace_binary<kind>;
        traversals[traversal_reference][kind][0] = trace_everything<kind>;
    }
}

}  // namespace

const PackVariant& RAYNEST_INTERSECTOR_FUNCTION() noexcept {
    static const PackVariant variant = [] {
        PackVariant v = cuda::make_variant<Isect, Kernels>(RAYNEST_INTERSECTOR_NAME);
        const bool bare = std::getenv("RAYNEST_FAKE_CUDA_BARE") != nullptr;
        if constexpr (cuda::runs_here<Isect>) {
            if (bare) return v;
            add_query<query_closest>(v);
            add_query<query_any>(v);
            add_query<query_multi>(v);
        }
        return v;
    }();
    return variant;
}

}  // namespace raynest
