// Primitives other than triangles: plain records with bounds() and intersect().
//
// A type becomes a primitive by two free functions found by argument-dependent lookup,
//
//     Box  bounds(const P&);
//     auto intersect(const auto& ray, const P&);    // RecordHits<P, N>, N = most hits
//
// and one row in geometry/primitives.def. `normal(const P&, Vec3 point)` is optional. The type must be
// trivially copyable, of whole 4-byte words and aligned to no more: a .npy row of floats becomes
// one as it is, and records lie one behind the other with a word between them.
#pragma once

#include "engine/geometry/box.h"
#include "engine/geometry/concepts.h"
#include "engine/geometry/intersection.h"
#include "engine/geometry/slabs.h"

#include <algorithm>
#include <concepts>
#include <type_traits>

namespace raynest {

/// A record in its place: the value and its index in the object, or the caller's id in a list.
template <class P>
struct Record {
    using record_tag = void;
    using value_type = P;
    static constexpr int lanes = 1;
    const P* value;
    std::uint32_t prim;
    bool first;  ///< the first record of its leaf

    [[nodiscard]] RAYNEST_INLINE std::uint32_t valid() const { return 1; }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t prim_of(int) const { return prim; }
    [[nodiscard]] RAYNEST_INLINE std::uint32_t geom_of(int) const { return 0; }
};

/// The result of a record's intersect(); lane k is the k-th hit.
template <class P, int N>
using RecordHits = Hits<Record<P>, N>;

/// The most hits that a primitive can report: a lane is a bit of Hits::mask.
inline constexpr int record_hits_max = 32;

/// For intersect() of a record with N hits at most: starts without hits, then add_hit() them
/// nearest first.
template <int N, class P>
RAYNEST_INLINE RecordHits<P, N> no_hits(const P& primitive) {
    static_assert(N >= 1 && N <= record_hits_max, "a primitive reports 1 to 32 hits");
    RecordHits<P, N> hits(Record<P>{&primitive, 0, true});
    hits.t = hits.u = hits.v = Lanes<N>::splat(0);
    return hits;
}

/// The number of a hit among the N of no_hits<N>(): a constant below N, else it does not compile.
template <int N>
struct HitNumber {
    int value;
    consteval HitNumber(int number) : value(number) {  // NOLINT(google-explicit-constructor)
        if (number < 0 || number >= N)
            throw "the second argument of add_hit() is the hit's number, from 0 to below the N of no_hits<N>()";
    }
};

/// Sets the hit of that number: each hit of the primitive has its own, 0 the nearest. The number is
/// `k` of the answer. Whether the hit lies in (tmin, tmax] is not the primitive's concern.
template <class P, int N>
RAYNEST_INLINE void add_hit(RecordHits<P, N>& hits, std::type_identity_t<HitNumber<N>> number,
                            float t, float u, float v, bool front) {
    const int k = number.value;
    hits.t.lane[k] = t;
    hits.u.lane[k] = u;
    hits.v.lane[k] = v;
    hits.front |= static_cast<std::uint32_t>(front) << k;
    hits.mask |= 1U << k;
}

/// The overload that kernels and intersectors call: asks the type's own intersect(), then holds its
/// hits to bounds() (geometry/slabs.h), so that rounding in either never makes a tree lose a hit.
template <class R, class P>
RAYNEST_INLINE auto intersect(const R& ray, const Record<P>& record) {
    auto hits = intersect(ray, *record.value);
    hits.primitive = record;
    if (hits.mask == 0) return hits;
    const auto own = own_interval(slabs_of(ray), Box(bounds(*record.value)));
    const float near = own.near.lane[0];
    const float far = own.far.lane[0];
    for (int k = 0; k < hits.lanes; ++k) {
        float& t = hits.t.lane[k];
        t = std::min(std::max(t, near), far);
        if (!(near <= far && t > ray.tmin && t <= ray.tmax)) hits.mask &= ~(1U << k);
    }
    return hits;
}

template <class P>
concept RecordPrimitive = std::is_trivially_copyable_v<P> && sizeof(P) % sizeof(float) == 0 &&
                          alignof(P) <= alignof(float) &&
                          requires(const P& primitive, const RayView& ray) {
    { bounds(primitive) } -> std::convertible_to<Box>;
    intersect(ray, primitive).mask;
    requires std::same_as<decltype(intersect(ray, primitive)),
                          RecordHits<P, decltype(intersect(ray, primitive))::lanes>>;
};

}  // namespace raynest
