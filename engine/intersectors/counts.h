// Counters, event by event: for kernels by the adapter (counting.h), for an explanation from
// the steps that an observer was told (inspection/explanation.cpp).
#pragma once

#include "engine/geometry/hit.h"

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace raynest {

/// The number of lanes in a mask.
RAYNEST_INLINE std::uint32_t lanes_of(std::uint32_t mask) {
    return static_cast<std::uint32_t>(std::popcount(mask));
}

/// Adds to two neighbouring counters by one load and one store.
template <std::size_t first, std::size_t second>
RAYNEST_INLINE void add_pair(Counters& c, std::uint32_t to_first, std::uint32_t to_second) {
    static_assert(second == first + sizeof(std::uint32_t) &&
                  std::endian::native == std::endian::little);
    auto* at = reinterpret_cast<std::byte*>(&c) + first;
    std::uint64_t both;
    std::memcpy(&both, at, sizeof both);
    both += std::uint64_t{to_second} << 32 | to_first;
    std::memcpy(at, &both, sizeof both);
}

/// A node: the boxes of its valid children, which are lanes of `tested`, are tested.
RAYNEST_INLINE void count_node(Counters& c, std::uint32_t tested) {
    add_pair<offsetof(Counters, nodes), offsetof(Counters, boxes)>(c, 1, lanes_of(tested));
}
/// The ray enters those boxes.
RAYNEST_INLINE void count_box_hits(Counters& c, std::uint32_t entered) {
    c.box_hits += lanes_of(entered);
}
/// A block of a leaf, or a record: so many primitives are tested. `leaves` is 1 for its leaf's
/// first, 0 for the others.
RAYNEST_INLINE void count_primitives(Counters& c, std::uint32_t leaves, std::uint32_t tested) {
    add_pair<offsetof(Counters, leaves), offsetof(Counters, prims)>(c, leaves, tested);
}
/// The ray hits those primitives, and the intersector refuses some of them.
RAYNEST_INLINE void count_candidates(Counters& c, std::uint32_t candidates, std::uint32_t refused) {
    c.rejects += lanes_of(refused);
    c.prim_hits += lanes_of(candidates);
}
/// The ray enters an instance. Until something in it is hit, it counts as one without a hit.
RAYNEST_INLINE void count_instance(Counters& c) {
    add_pair<offsetof(Counters, instances), offsetof(Counters, instance_misses)>(c, 1, 1);
}
/// Something is hit in that many instances which counted as ones without a hit.
RAYNEST_INLINE void count_instances_hit(Counters& c, std::uint32_t instances) {
    c.instance_misses -= instances;
}

}  // namespace raynest
