// The paper's third use case, as an adapter: the heat map of exactly the intersector that is used.
#pragma once

#include "engine/bvh/intersect_with.h"
#include "engine/bvh/visit.h"

#include <bit>

namespace raynest {

/// Counts a ray's questions (geometry/hit.h, Counters) and answers what `Base` answers.
template <class Base>
struct Counting {
    Base& base;
    Counters* counters;  ///< one per ray of the chunk: counters[ray.id]

    /// A node: its valid children are tested.
    auto operator()(const auto& ray, const BoxLike auto& boxes) {
        Counters& c = counters[ray.id];
        ++c.nodes;
        c.boxes += static_cast<std::uint32_t>(std::popcount(boxes.valid()));
        return intersect_with(base, ray, boxes);
    }

    /// A block of a leaf, or a record.
    auto operator()(const auto& ray, const PrimitiveLike auto& primitive) {
        Counters& c = counters[ray.id];
        if constexpr (requires { primitive.first; }) {
            c.leaves += primitive.first ? 1 : 0;
        } else {
            ++c.leaves;
        }
        c.prims += static_cast<std::uint32_t>(std::popcount(primitive.valid()));
        auto hits = intersect_with(base, ray, primitive);
        if constexpr (Overrides<Base, decltype(ray), decltype(primitive)>) {
            const std::uint32_t candidates = intersect(ray, primitive).mask;
            c.rejects += static_cast<std::uint32_t>(std::popcount(candidates & ~hits.mask));
        }
        return hits;
    }

    bool operator()(const auto& ray, const InstanceLike auto& instance) {
        if (!enters(base, ray, instance)) return false;
        ++counters[ray.id].instances;
        return true;
    }
};

}  // namespace raynest
