// The kernels that compare_code.py disassembles. Compiled three times per target: with hooks, with
// every hook call compiled out (RAYNEST_NO_HOOKS), and with an intersector that overloads triangles
// but keeps every candidate (ZERO_COST_CONTROL), which must be found different.
#include "engine/intersectors/opaque.h"
#include "engine/packs/variant.h"

namespace raynest {

#ifdef ZERO_COST_CONTROL
struct Tested {
    static constexpr const char* text = "control: examines every candidate and keeps it";
    auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([](const Surface& surface) { return surface.t < 1e30F; });
        return hits;
    }
};
#else
struct Tested : Opaque {};
#endif

template TraceStatus trace<Tested, query_closest, traversal_single, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_any, traversal_single, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_multi, traversal_single, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace_all<Tested, traversal_single>(const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_closest, traversal_stream, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_any, traversal_stream, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_multi, traversal_stream, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_closest, traversal_packet, counters_none>(
    const TraceCall*) noexcept;
template TraceStatus trace<Tested, query_any, traversal_packet, counters_none>(
    const TraceCall*) noexcept;

}  // namespace raynest
