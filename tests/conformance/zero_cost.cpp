// The kernels that compare_code.py disassembles. Compiled three times per target: with hooks, with
// every hook call compiled out (RAYNEST_NO_HOOKS), and with an intersector that overloads triangles
// only to keep every candidate (ZERO_COST_CONTROL), which must be seen as different.
#include "engine/intersectors/opaque.h"
#include "engine/packs/variant.h"

namespace raynest {

#ifdef ZERO_COST_CONTROL
struct Tested {
    static constexpr const char* text = "control: looks at every candidate and keeps it";
    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([](const Surface& surface) { return surface.t < 1e30F; });
        return hits;
    }
};
#else
struct Tested : Opaque {};
#endif

template TraceStatus trace<Tested, query_closest, traversal_latency, false>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_any, traversal_latency, false>(const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_multi, traversal_latency, false>(
    const TraceCall*) noexcept;
template TraceStatus trace_all<Tested, traversal_latency>(const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_closest, traversal_batch, false>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_any, traversal_batch, false>(const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_multi, traversal_batch, false>(const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_closest, traversal_coherent, false>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_any, traversal_coherent, false>(const TraceCall*) noexcept;

}  // namespace raynest
