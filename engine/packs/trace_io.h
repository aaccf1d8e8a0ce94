// The input and output of kernels: rays by number, and the arrays of their answers.
#pragma once

#include "engine/geometry/ray_view.h"
#include "engine/math/lanes.h"
#include "engine/packs/abi.h"
#include "engine/queries/queries.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <type_traits>

namespace raynest {

class TriedGuesses;

/// is_valid(), with one branch.
[[nodiscard]] RAYNEST_INLINE bool is_valid_at_once(const Ray& ray) {
    using F = Lanes<4>;
    if constexpr (F::width == 1) return is_valid(ray);
    const F most = F::splat(std::numeric_limits<float>::max());
    const auto size = [](const Vec3& v) RAYNEST_INLINE_LAMBDA {
        const F lanes = F::of(v);
        return flip_sign(lanes, lanes);
    };
    const F reach = size(ray.direction);
    const std::uint32_t finite = less_equal(size(ray.origin), most) & less_equal(reach, most);
    const bool directed = (less(F::splat(0), reach) & 7U) != 0;
    const auto bit = [](bool is) RAYNEST_INLINE_LAMBDA { return static_cast<unsigned>(is); };
    return (bit(finite == 15U) & bit(directed) & bit(ray.tmin >= 0) & bit(ray.tmin <= ray.tmax) &
            bit(ray.tmin <= std::numeric_limits<float>::max())) != 0;
}

/// ClosestHit in the place of its answer: a copy would wait for the stores that it was written with.
struct ClosestInPlace {
    static constexpr bool ordered = true;
    HitRecord* best;
    Cancellation* cancellation = nullptr;

    template <class R, class P, int N>
    RAYNEST_INLINE bool take(R& ray, const Hits<P, N>& hits) {
        for_each_record(ray, hits, [&](int, const HitRecord& record) {
            if (record.before(*best)) {
                *best = record;
                ray.tmax = record.t;
            }
        });
        return false;
    }
};

/// Rays [0, count) of a group, by number, and the arrays of their answers.
template <Query kind>
struct TraceIO {
    using Query = std::conditional_t<kind == query_closest, ClosestHit,
                                     std::conditional_t<kind == query_any, AnyHit, MultiHit>>;
    const TraceCall& call;
    std::uint32_t first;                   ///< the group's first ray in the call
    Cancellation* cancellation = nullptr;  ///< the call's
    TriedGuesses* guesses = nullptr;       ///< the call's

    [[nodiscard]] RAYNEST_INLINE const Ray* rays() const { return call.rays + first; }
    /// Asks memory for rays [from, to) of the group or behind it, as far as the call has them.
    RAYNEST_INLINE void prefetch_rays(std::uint32_t from, std::uint32_t to) const {
        const std::uint32_t end = std::min(to, call.ray_count - first);
        for (std::uint32_t i = from; i < end; i += cache_line / sizeof(Ray)) {
            __builtin_prefetch(rays() + i);
        }
    }
    /// Asks memory for the places of the answers of rays [0, count).
    RAYNEST_INLINE void prefetch_answers(std::uint32_t count) const {
        for (std::uint32_t i = 0; i < count; i += cache_line / sizeof(HitRecord)) {
            __builtin_prefetch(hits_of(i), 1);
        }
    }
    /// The ray as it enters the root; false when it is invalid and thereby answered.
    [[nodiscard]] RAYNEST_INLINE bool begin(std::uint32_t i, RayView& view) const {
        const Ray& ray = rays()[i];
        if (!is_valid_at_once(ray)) {
            refuse(i);
            return false;
        }
        view = outermost_view(ray, call.scene, i, call.mask, call.flags);
        view.object = &call.scene->objects[call.scene->root];
        return true;
    }
    [[nodiscard]] RAYNEST_INLINE Query query(std::uint32_t i) const {
        if constexpr (kind == query_multi) {
            return {std::span(hits_of(i), call.hits_max), 0, cancellation};
        } else {
            return {{}, cancellation};
        }
    }
    /// A query that leaves its answer where it belongs, as far as it can.
    [[nodiscard]] RAYNEST_INLINE auto query_in_place(std::uint32_t i) const {
        if constexpr (kind == query_closest) {
            HitRecord* const best = hits_of(i);
            *best = HitRecord{};
            return ClosestInPlace{best, cancellation};
        } else {
            return query(i);
        }
    }
    RAYNEST_INLINE void end(std::uint32_t /*i*/, const ClosestInPlace& /*query*/) const {}
    RAYNEST_INLINE void end(std::uint32_t i, const Query& query) const {
        if constexpr (kind == query_closest) {
            *hits_of(i) = query.best;
        } else if constexpr (kind == query_any) {
            HitRecord answer;
            answer.hit = query.found ? 1 : 0;
            *hits_of(i) = answer;
        } else {
            call.hit_counts[first + i] = query.count;
            if (query.count == 0) *hits_of(i) = HitRecord{};
        }
    }

    /// Instead of begin(): the ray is invalid.
    RAYNEST_INLINE void refuse(std::uint32_t i) const { end_without_hit(i, hit_invalid_ray); }
    /// Instead of end(): there is no answer.
    RAYNEST_INLINE void give_up(std::uint32_t i) const { end_without_hit(i, hit_given_up); }

private:
    static constexpr std::uint32_t cache_line = 64;

    RAYNEST_INLINE void end_without_hit(std::uint32_t i, HitFlags flag) const {
        HitRecord answer;
        answer.flags = flag;
        *hits_of(i) = answer;
        if constexpr (kind == query_multi) call.hit_counts[first + i] = 0;
    }
    [[nodiscard]] RAYNEST_INLINE HitRecord* hits_of(std::uint32_t i) const {
        return call.hits + static_cast<std::size_t>(first + i) * call.hits_max;
    }
};

}  // namespace raynest
