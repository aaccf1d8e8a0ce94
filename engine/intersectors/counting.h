// The paper's third use case, as an adapter: the heat map of exactly the intersector that is used.
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/bvh/visit.h"

#include <bit>
#include <cstddef>
#include <cstdint>

namespace raynest {

/// Counts a ray's questions (geometry/hit.h, Counters) and answers what `Base` answers. `ByLevel`:
/// the questions of each level apart; their sum is what is counted otherwise.
template <class Base, bool ByLevel = false>
struct Counting {
    Base& base;
    Counters* counters;        ///< of the chunk's rays, `levels` of each
    std::uint32_t levels = 1;  ///< of the scene, if ByLevel

    /// A node: its valid children are tested.
    auto operator()(const auto& ray, const BoxLike auto& boxes) {
        Counters& c = of(ray);
        ++c.nodes;
        c.boxes += static_cast<std::uint32_t>(std::popcount(boxes.valid()));
        auto spans = intersect_with(base, ray, boxes);
        c.box_hits += static_cast<std::uint32_t>(std::popcount(spans.mask));
        return spans;
    }

    /// A block of a leaf, or a record.
    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        Counters& c = of(ray);
        if constexpr (requires { primitive.first; }) {
            c.leaves += primitive.first ? 1 : 0;
        } else {
            ++c.leaves;
        }
        c.prims += static_cast<std::uint32_t>(std::popcount(primitive.valid()));
        auto hits = intersect_with(base, ray, primitive);
        std::uint32_t candidates = hits.mask;
        if constexpr (Overrides<Base, decltype(ray), decltype(primitive)>) {
            candidates = intersect(ray, primitive).mask;
            c.rejects += static_cast<std::uint32_t>(std::popcount(candidates & ~hits.mask));
        }
        c.prim_hits += static_cast<std::uint32_t>(std::popcount(candidates));
        return hits;
    }

    bool operator()(const auto& ray, const InstanceLike auto& instance) {
        if (!enters(base, ray, instance)) return false;
        ++of(ray).instances;
        return true;
    }

private:
    RAYNEST_INLINE Counters& of(const auto& ray) const {
        return ByLevel ? counters[std::size_t{ray.id} * levels + ray.level] : counters[ray.id];
    }
};

}  // namespace raynest
