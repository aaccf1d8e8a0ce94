// One ray of a call: what a thread of a GPU does, and in tests a turn of a loop on the host.
#pragma once

#include "engine/cuda/traverse.h"
#include "engine/packs/describe.h"
#include "engine/packs/feed.h"

#include <cstdint>

namespace raynest::cuda {

/// What an intersector puts out may depend on the order in which it is asked (packs/variant.h),
/// which is another one here: those run on the CPU.
template <class Isect>
inline constexpr bool runs_here = !requires {
    Isect::outputs;
};

/// Answers ray i.
template <class Isect, Query kind, class Trees>
RAYNEST_INLINE void trace_ray(const TraceCall& call, const Trees& trees,
                              const typename ParamsOf<Isect>::type& values, std::uint32_t i) {
    const Feed<kind> feed{call, 0};
    RayView view;
    if (!feed.begin(i, view)) return;
    Isect isect = make_intersector<Isect>(*call.scene, values);
    auto query = feed.query(i);
    if (traverse_levels(view, trees, isect, query))
        feed.end(i, query);
    else
        feed.give_up(i);
}

}  // namespace raynest::cuda
