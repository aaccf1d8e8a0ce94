// The tree's one node: 8 children, 256 bytes, structure of arrays.
//
//   lower x[8] y[8] z[8] | upper x[8] y[8] z[8] | child[8] | order[8]
//
// Child word (32 bits), offsets relative to the object (ObjectRecord::first_node, first_block,
// ...):
//   0xFFFFFFFF                      empty slot
//   0 | node                        inner node
//   1 00 | first block << 3 | n-1   leaf: n triangle blocks of 8 (1..8)
//   1 01 | instance                 leaf: one instance, index in declaration order
//   1 10 | first record << 3 | n-1  leaf: n records of another primitive type (1..8)
//
// order[i] holds, for each of the 8 ray octants, 3 bits: the slot that comes i-th when the children
// are sorted near to far along the octant's diagonal (idea: jbikker/tinybvh). The top byte of
// order[0] is the mask of valid slots. These are the first slots, and come first in every order.
//
// A second layout for batches, 128 bytes with planes of 8 bits, was measured and does not pay: it
// saves half of a node's cache lines, but nodes are a tenth of a tree's bytes, and its planes have
// to be decoded. 0.80 to 0.95 of this one's rate up to 8 million triangles; at 12.5 million 0.96 of
// random rays and 0.87 of diffuse ones.
#pragma once

#include "engine/math/vec.h"

#include <cstdint>

namespace raynest {

inline constexpr std::uint32_t child_empty = 0xFFFFFFFFU;
inline constexpr std::uint32_t tree_height_max = 48;

struct alignas(64) Node {
    float lower[3][8];
    float upper[3][8];
    std::uint32_t child[8];
    std::uint32_t order[8];

    [[nodiscard]] RAYNEST_FN std::uint32_t valid() const { return order[0] >> 24; }
};
static_assert(sizeof(Node) == 256);

enum class ChildKind : std::uint32_t { triangles = 0, instance = 1, records = 2 };

[[nodiscard]] constexpr bool is_leaf(std::uint32_t child) {
    return (child >> 31) != 0;
}
[[nodiscard]] constexpr ChildKind kind_of(std::uint32_t leaf) {
    return static_cast<ChildKind>((leaf >> 29) & 3U);
}
/// First block or record of a leaf, and how many.
[[nodiscard]] constexpr std::uint32_t leaf_first(std::uint32_t leaf) {
    return (leaf & 0x1FFFFFFFU) >> 3;
}
[[nodiscard]] constexpr std::uint32_t leaf_count(std::uint32_t leaf) {
    return (leaf & 7U) + 1;
}
[[nodiscard]] constexpr std::uint32_t leaf_instance(std::uint32_t leaf) {
    return leaf & 0x1FFFFFFFU;
}
/// Largest block, or place of a record, that a leaf can name.
inline constexpr std::uint32_t leaf_first_max = (1U << 26) - 1;
inline constexpr std::uint32_t leaf_instance_max = (1U << 29) - 2;

[[nodiscard]] constexpr std::uint32_t make_leaf(ChildKind kind, std::uint32_t first,
                                                std::uint32_t count) {
    return 0x80000000U | (static_cast<std::uint32_t>(kind) << 29) | (first << 3) | (count - 1);
}
[[nodiscard]] constexpr std::uint32_t make_instance_leaf(std::uint32_t instance) {
    return 0x80000000U | (static_cast<std::uint32_t>(ChildKind::instance) << 29) | instance;
}

}  // namespace raynest
