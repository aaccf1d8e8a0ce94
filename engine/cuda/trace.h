// Traces one ray of a call: the work of one GPU thread; in tests, one iteration of a loop on the
// host.
#pragma once

#include "engine/cuda/traverse.h"
#include "engine/packs/describe.h"
#include "engine/packs/trace_io.h"

#include <cstdint>

namespace raynest::cuda {

/// True if an intersector runs on a GPU: it has no outputs and no tables. Outputs may depend on the
/// order of the tests (packs/variant.h), which differs here; tables lie in the host's memory.
template <class Isect>
inline constexpr bool runs_here = !has_outputs<Isect> && !takes_tables<Isect>();

/// Answers ray i.
template <class Isect, Query kind, class Trees>
RAYNEST_INLINE void trace_ray(const TraceCall& call, const Trees& trees,
                              const typename ParamsOf<Isect>::type& values, std::uint32_t i) {
    const TraceIO<kind> io{call, 0};
    RayView view;
    if (!io.begin(i, view)) return;
    Isect isect = make_intersector<Isect>(*call.scene, values);
    auto query = io.query(i);
    if (traverse_levels(view, trees, isect, query))
        io.end(i, query);
    else
        io.give_up(i);
}

}  // namespace raynest::cuda
