// The visibility queries: what is kept of the candidates that survive the intersector.
//
// take(ray, hits) sees the surviving lanes of one primitive or block, keeps what it wants, shrinks
// ray.tmax to the farthest distance that can still matter and returns true when nothing can. Hits
// are ordered by (t, path, geom, prim, k): of equal t the smaller key wins,
// whatever the order of traversal, so answers do not depend on the tree.
//
// A query also carries the word of its caller, where there is one, that it is wanted no more: the
// search ends as if it were answered.
#pragma once

#include "engine/bvh/cancellation.h"
#include "engine/geometry/concepts.h"
#include "engine/geometry/hit.h"
#include "engine/geometry/intersection.h"

#include <algorithm>
#include <cstdint>
#include <span>

namespace raynest {

/// The record of one surviving lane.
template <class P, int N>
RAYNEST_INLINE HitRecord make_record(const RayView& ray, const Hits<P, N>& hits, int lane, float t,
                                     float u, float v) {
    HitRecord record;
    record.t = t;
    record.u = u;
    record.v = v;
    record.triangle = hits.primitive.prim_of(lane);
    record.path = ray.path;
    record.object =
        ray.object != nullptr ? static_cast<std::uint32_t>(ray.object - ray.scene->objects) : no_id;
    record.k = RecordLike<P> ? static_cast<std::uint8_t>(lane) : std::uint8_t{0};
    record.front = static_cast<std::uint8_t>(hits.front >> lane & 1U);
    record.hit = 1;
    return record;
}

/// Calls `f(lane, record)` for every surviving lane.
template <class P, int N, class F>
RAYNEST_INLINE void for_each_record(const RayView& ray, const Hits<P, N>& hits, F&& f) {
    alignas(32) float t[Hits<P, N>::lane_count];
    alignas(32) float u[Hits<P, N>::lane_count];
    alignas(32) float v[Hits<P, N>::lane_count];
    hits.t.store(t);
    hits.u.store(u);
    hits.v.store(v);
    for_each_lane<N>(hits.mask, [&](int lane) RAYNEST_INLINE_LAMBDA {
        f(lane, make_record(ray, hits, lane, t[lane], u[lane], v[lane]));
    });
}

/// The nearest hit.
struct ClosestHit {
    static constexpr bool ordered = true;  ///< visiting near children first pays
    HitRecord best;
    Cancellation* cancellation = nullptr;

    template <class R, class P, int N>
    RAYNEST_INLINE bool take(R& ray, const Hits<P, N>& hits) {
        for_each_record(ray, hits, [&](int, const HitRecord& record) { add(record, ray.tmax); });
        return false;
    }
    /// One hit of a ray whose search ends at `tmax`.
    RAYNEST_INLINE bool add(const HitRecord& record, float& tmax) {
        if (record.before(best)) {
            best = record;
            tmax = record.t;
        }
        return false;
    }
};

/// Whether anything is hit. Which surface depends on the traversal, so nothing else is kept.
struct AnyHit {
    static constexpr bool ordered = false;
    bool found = false;
    Cancellation* cancellation = nullptr;

    template <class R, class P, int N>
    RAYNEST_INLINE bool take(R& /*ray*/, const Hits<P, N>& hits) {
        found = hits.mask != 0;
        return found;
    }
    RAYNEST_INLINE bool add(const HitRecord& /*record*/, float& /*tmax*/) {
        found = true;
        return true;
    }
};

/// The nearest hits, sorted, as many as the caller's span holds. Once it is full, its last distance
/// ends the search.
struct MultiHit {
    static constexpr bool ordered = true;
    std::span<HitRecord> nearest;  ///< capacity >= 1; the first `count` are filled
    std::uint32_t count = 0;
    Cancellation* cancellation = nullptr;

    template <class R, class P, int N>
    RAYNEST_INLINE bool take(R& ray, const Hits<P, N>& hits) {
        for_each_record(ray, hits, [&](int, const HitRecord& record) { insert(record); });
        if (count == nearest.size()) ray.tmax = nearest[count - 1].t;
        return false;
    }

private:
    RAYNEST_FN void insert(const HitRecord& record) {
        const bool full = count == nearest.size();
        if (full && !record.before(nearest[count - 1])) return;
        std::uint32_t at = count;
        while (at > 0 && record.before(nearest[at - 1])) --at;
        // The same hit again: a tree with spatial splits names a triangle in several leaves.
        if (at > 0 && !nearest[at - 1].before(record)) return;
        if (!full) ++count;
        for (std::uint32_t i = count - 1; i > at; --i) nearest[i] = nearest[i - 1];
        nearest[at] = record;
    }
};

/// All hits, sorted when the search has ended. Of more than `budget` the nearest are kept.
///
/// Hits are collected as they come. When the room is full they are sorted, and what is double or
/// beyond the budget goes; from then on the last distance of the budget ends the search, as that of
/// MultiHit does. Every such pass frees at least half of the room, so the time is linear in the
/// hits but for the sorting; a room that is too small for that is no answer.
struct AllHits {
    static constexpr bool ordered = false;
    std::span<HitRecord> room;  ///< 2 * budget records are enough for any ray
    std::uint32_t budget = 1;
    std::uint32_t count = 0;
    bool truncated = false;  ///< there are more hits than the budget
    bool fits = true;        ///< false: the room was too small, and the rest means nothing
    Cancellation* cancellation = nullptr;

    template <class R, class P, int N>
    RAYNEST_INLINE bool take(R& ray, const Hits<P, N>& hits) {
        for_each_record(ray, hits, [&](int, const HitRecord& record) {
            if (count == room.size()) [[unlikely]]
                make_room(ray.tmax);
            if (fits) [[likely]]
                room[count++] = record;
        });
        return !fits;
    }

    /// Ends the search: sorts what was found.
    void finish() {
        const auto end = room.begin() + count;
        const auto before = [](const HitRecord& a, const HitRecord& b) { return a.before(b); };
        std::sort(room.begin(), end, before);
        // The same hit again: a tree with spatial splits names a triangle in several leaves.
        const auto same = [](const HitRecord& a, const HitRecord& b) { return !a.before(b); };
        count = static_cast<std::uint32_t>(std::unique(room.begin(), end, same) - room.begin());
        truncated = truncated || count > budget;
        count = std::min(count, budget);
    }

private:
    [[gnu::noinline]] void make_room(float& tmax) {
        finish();
        fits = !room.empty() && 2 * std::size_t{count} <= room.size();
        if (truncated) tmax = room[budget - 1].t;
    }
};

}  // namespace raynest
