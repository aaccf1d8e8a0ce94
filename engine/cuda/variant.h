// The table of one intersector on GPUs: host functions that launch its kernels.
//
// Counters exist only on the CPU.
#pragma once

#include "engine/cuda/launch.h"
#include "engine/cuda/trace.h"

namespace raynest::cuda {

/// Launches a query's kernel, `Kernels::of<kind>()`: kernel(TraceCall, CompressedTrees, values).
template <class Isect, class Kernels, Query kind>
TraceStatus trace(const TraceCall* call) noexcept {
    auto values = read_params<Isect>(*call);
    return launch(*call, kind, Kernels::template of<kind>(), &values);
}

template <class Isect, class Kernels>
PackVariant make_variant(const char* name) {
    PackVariant variant = describe_variant<Isect>(name);
    if constexpr (runs_here<Isect>) {
        auto& queries = variant.trace[traversal_single];
        queries[query_closest][0] = trace<Isect, Kernels, query_closest>;
        queries[query_any][0] = trace<Isect, Kernels, query_any>;
        queries[query_multi][0] = trace<Isect, Kernels, query_multi>;
    }
    return variant;
}

}  // namespace raynest::cuda
