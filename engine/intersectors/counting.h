// The paper's third use case, as an adapter: the heat map of exactly the intersector that is used.
//
// It is inlined as the intersector is: called, it would hand over a block's hits through memory,
// which cost alpha masks 10 to 20 %.
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/bvh/visit.h"
#include "engine/intersectors/counts.h"
#include "engine/math/mask.h"
#include "engine/math/words.h"

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace raynest {

/// Triangles that note which of them a ray hits as soon as an intersector asks intersect() for it.
struct NotedTriangles8 : Triangles8 {
    static constexpr std::uint32_t not_asked = ~0U;
    const RayView* of;     ///< the ray that is noted
    std::uint32_t* found;  ///< its candidates; `not_asked` before

    RAYNEST_INLINE NotedTriangles8(const Triangles8& base, const RayView& ray,
                                   std::uint32_t& candidates)
        : Triangles8(base),
          of(&ray),
          found(&candidates) {}
};

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const NotedTriangles8& triangles) {
    const auto hits = intersect(ray, static_cast<const Triangles8&>(triangles));
    if (static_cast<const RayView*>(&ray) == triangles.of) *triangles.found = hits.mask;
    return hits;
}

/// Converts to triangles, and is none itself.
struct TrianglesByName {
    operator const Triangles8&() const;  // NOLINT(google-explicit-constructor)
};
/// True if an intersector has an overload for this very type, which another type would not choose.
template <class Isect, class R>
concept NamesTriangles8 = Overrides<Isect, R, TrianglesByName>;

/// Counts a ray's questions (geometry/hit.h, Counters) and answers what `Base` answers. `ByLevel`:
/// the questions of each level apart; their sum is what is counted otherwise.
template <class Base, bool ByLevel = false>
struct Counting {
    Base& base;
    Counters* counters;        ///< for the chunk's rays, `levels` of each
    std::uint32_t levels = 1;  ///< the scene's, if ByLevel
    /// Bit l: the instance that the ray entered last at level l counts as one without a hit.
    std::uint32_t missed = 0;

    /// A node: its valid children are tested.
    RAYNEST_INLINE auto operator()(const auto& ray, const BoxLike auto& boxes) {
        Counters& c = of(ray);
        count_node(c, boxes.valid());
        auto spans = intersect_with(base, ray, boxes);
        count_box_hits(c, spans.mask);
        return spans;
    }

    /// A block of a leaf, or a record.
    RAYNEST_INLINE auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        using R = std::remove_cvref_t<decltype(ray)>;
        using P = std::remove_cvref_t<decltype(primitive)>;
        Counters& c = of(ray);
        std::uint32_t leaves = 1;
        if constexpr (requires { primitive.first; }) leaves = primitive.first ? 1 : 0;
        count_primitives(c, leaves, count_of(primitive));
        if constexpr (!Overrides<Base, R, P>) {
            auto hits = intersect(ray, primitive);
            if (hits.mask != 0) add_candidates(ray, hits.mask, hits.mask);
            return hits;
        } else if constexpr (std::is_same_v<P, Triangles8> && Overrides<Base, R, NotedTriangles8> &&
                             !NamesTriangles8<Base, R>) {
            std::uint32_t candidates = NotedTriangles8::not_asked;
            auto hits = base(ray, NotedTriangles8(primitive, ray, candidates));
            if (candidates == NotedTriangles8::not_asked)
                candidates = intersect(ray, primitive).mask;
            if (candidates != 0) add_candidates(ray, candidates, hits.mask);
            return hits;
        } else {
            auto hits = base(ray, primitive);
            add_candidates(ray, intersect(ray, primitive).mask, hits.mask);
            return hits;
        }
    }

    RAYNEST_INLINE bool operator()(const auto& ray, const InstanceLike auto& instance) {
        if (!enters(base, ray, instance)) return false;
        count_instance(of(ray));
        missed |= 1U << ray.level;
        return true;
    }

private:
    RAYNEST_INLINE Counters& of(const auto& ray) const {
        return ByLevel ? counters[std::size_t{ray.id} * levels + ray.level] : counters[ray.id];
    }
    RAYNEST_INLINE static std::uint32_t count_of(const Triangles8& triangles) {
        return count_other_words(triangles.block->triangle, no_id);
    }
    RAYNEST_INLINE static std::uint32_t count_of(const auto& primitive) {
        return lanes_of(primitive.valid());
    }
    RAYNEST_INLINE void add_candidates(const auto& ray, std::uint32_t candidates,
                                       std::uint32_t accepted) {
        count_candidates(of(ray), candidates, candidates & ~accepted);
        const std::uint32_t found = missed & ((1U << ray.level) - 1);
        if (found != 0 && candidates != 0) leave_missed(ray, found);
    }
    /// The instances around the ray, of which `found` are counted as missed, have a hit.
    RAYNEST_NOINLINE void leave_missed(const auto& ray, std::uint32_t found) {
        missed &= ~found;
        if constexpr (ByLevel) {
            for (; found != 0; found &= found - 1)
                count_instances_hit(counters[std::size_t{ray.id} * levels + lowest_bit(found)], 1);
        } else {
            count_instances_hit(counters[ray.id], lanes_of(found));
        }
    }
};

}  // namespace raynest
