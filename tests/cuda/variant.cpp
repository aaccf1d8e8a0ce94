// One intersector of the cuda target on the host: the functions that a GPU's threads run, in a loop
// over the rays. A pack of these goes through the whole of conformance, so a machine without a GPU
// knows that the walk, the compressed trees and the hooks are right, bit for bit; it does not know
// that nvcc's arithmetic is g++'s. tests/cuda/CMakeLists.txt compiles this file as
// packs/variant.cpp is.
//
// `latency` stands for the compressed trees, `batch` for their binary twin.
#include "engine/cuda/check.h"
#include "engine/cuda/compress.h"
#include "engine/cuda/trace.h"
#include "engine/queries/reference.h"
#include "tests/cuda/binary_trees.h"

#include RAYNEST_INTERSECTOR_HEADER

#include <cstdint>

namespace raynest {
namespace {

using Isect = RAYNEST_INTERSECTOR_TYPE;
static_assert(cuda::check_intersector<Isect, Declared{RAYNEST_INTERSECTOR_OVERRIDES}>());

template <Query kind, class Trees>
void trace_rays(const TraceCall& call, const Trees& trees) {
    const auto values = read_params<Isect>(call);
    for (std::uint32_t i = 0; i < call.ray_count; ++i) {
        cuda::trace_ray<Isect, kind>(call, trees, values, i);
    }
}

template <Query kind>
TraceStatus trace_compressed(const TraceCall* call) noexcept {
    const auto trees = cuda::compress(*call->scene);
    if (!trees) return trace_too_deep;
    trace_rays<kind>(*call, trees->view());
    return trace_ok;
}

template <Query kind>
TraceStatus trace_binary(const TraceCall* call) noexcept {
    if (!cuda::compress(*call->scene)) return trace_too_deep;
    trace_rays<kind>(*call, cuda::BinaryTrees(*call->scene));
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
        traversals[traversal_latency][kind][0] = trace_compressed<kind>;
        traversals[traversal_batch][kind][0] = trace_binary<kind>;
        traversals[traversal_reference][kind][0] = trace_everything<kind>;
    }
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
