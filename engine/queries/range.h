// closest_hit, any_hit and multi_hit over a range of anything that can be hit, with and without an
// intersector: the paper's interface for programs that embed the engine.
//
// A range holds triangles, records, BVHs or instances: a plain list with no tree, one tree, or
// several roots. It acts as an object of its own: element i takes the path ids after those of the
// elements before it, so `path` of a hit tells the element (a plain primitive is one placement).
// The best distance shrinks from element to element.
//
// An intersector with `outputs` sees each triangle once per ray. Any other that counts what it sees
// is asked in each leaf that names a triangle, and trees of a high build name some in several.
#pragma once

#include "engine/bvh/visit.h"
#include "engine/intersectors/each_once.h"
#include "engine/intersectors/opaque.h"
#include "engine/queries/queries.h"

#include <array>
#include <cstdint>
#include <iterator>

namespace raynest {

/// A record outside any object: visited like one inside.
template <class R, RecordPrimitive P, class Isect, class Query>
RAYNEST_INLINE bool visit(R& ray, const P& primitive, Isect& isect, Query& query) {
    return visit(ray, Record<P>{&primitive, 0, true}, isect, query);
}

/// Runs `query` over [first, last). An invalid ray (geometry/ray.h) hits nothing.
template <class Iterator, class Isect, class Query>
void trace_range(const Ray& ray, Iterator first, Iterator last, Isect& isect, Query& query) {
    if (!is_valid(ray)) return;
    MemoryOf<Isect> memory;
    auto&& asked = each_once(isect, memory);
    RayView view = outermost_view(ray, nullptr, 0, 0xFFFFFFFFU, 0);
    std::uint64_t path = 0;
    for (; first != last; ++first) {
        view.path = path;
        // The way into an instance adds what comes before it in its own object, not in the list.
        if constexpr (InstanceLike<decltype(*first)>) view.path -= first->record().path_base;
        if (visit(view, *first, asked, query)) return;
        if constexpr (requires { first->placement_count(); }) {
            path += first->placement_count();
        } else {
            path += 1;
        }
    }
}

/// The nearest hit; `hit` is 0 in the record when there is none. `isect` is taken by reference:
/// what it counts stays in it.
template <class Iterator, class Isect>
[[nodiscard]] HitRecord closest_hit(const Ray& ray, Iterator first, Iterator last, Isect&& isect) {
    ClosestHit query;
    trace_range(ray, first, last, isect, query);
    return query.best;
}

/// Whether anything is hit.
template <class Iterator, class Isect>
[[nodiscard]] bool any_hit(const Ray& ray, Iterator first, Iterator last, Isect&& isect) {
    AnyHit query;
    trace_range(ray, first, last, isect, query);
    return query.found;
}

/// The N nearest hits, sorted; `count` of them are filled.
template <std::size_t N>
struct MultiHits {
    std::array<HitRecord, N> hits;
    std::uint32_t count = 0;
};

template <std::size_t N, class Iterator, class Isect>
[[nodiscard]] MultiHits<N> multi_hit(const Ray& ray, Iterator first, Iterator last, Isect&& isect) {
    static_assert(N > 0);
    MultiHits<N> result;
    MultiHit query{result.hits};
    trace_range(ray, first, last, isect, query);
    result.count = query.count;
    return result;
}

template <class Iterator>
[[nodiscard]] HitRecord closest_hit(const Ray& ray, Iterator first, Iterator last) {
    return closest_hit(ray, first, last, Opaque{});
}

template <class Iterator>
[[nodiscard]] bool any_hit(const Ray& ray, Iterator first, Iterator last) {
    return any_hit(ray, first, last, Opaque{});
}

template <std::size_t N, class Iterator>
[[nodiscard]] MultiHits<N> multi_hit(const Ray& ray, Iterator first, Iterator last) {
    return multi_hit<N>(ray, first, last, Opaque{});
}

}  // namespace raynest
