// The cheapest cut of a binary tree into 8-wide nodes and leaves, planned from the leaves up.
//
// The dynamic program of Ylitie, Karras, Laine, "Efficient incoherent ray traversal on GPUs through
// compressed wide BVHs" (2017): for every binary node the least cost of representing its subtree by
// at most 1..8 roots. Costs travel upwards with the recursion that builds the tree; of each node
// only 32 bits of decisions stay.
#pragma once

#include "engine/bvh/node.h"

#include <array>
#include <cstdint>
#include <limits>

namespace raynest::build {

// Costs relative to one node visit. Block costs of 0.5 to 0.8 trace alike (1.2: 3 % slower); the
// least of them would save 3 % of memory.
inline constexpr float node_cost = 1.0F;
inline constexpr float block_cost = 0.6F;
inline constexpr float record_cost = 0.4F;
inline constexpr float instance_cost = 4.0F;
inline constexpr std::uint32_t leaf_triangles_max = 16;
inline constexpr std::uint32_t leaf_records_max = 8;

/// The contents of a subtree, to decide whether one leaf can hold them: a bit per ChildKind, and
/// their number.
struct Load {
    std::uint32_t kinds;
    std::uint32_t count;
};

constexpr std::uint32_t only(ChildKind kind) {
    return 1U << static_cast<std::uint32_t>(kind);
}

/// Blocks or records of a leaf that holds the load.
inline std::uint32_t leaf_entries(const Load& load) {
    if (load.kinds == only(ChildKind::triangles)) return (load.count + 7) / 8;
    return load.kinds == only(ChildKind::records) ? load.count : 0;
}

/// Infinite where no leaf can hold the load.
inline float leaf_cost(const Load& load, float half_area) {
    const auto entries = static_cast<float>(leaf_entries(load));
    if (load.kinds == only(ChildKind::triangles) && load.count <= leaf_triangles_max) {
        return half_area * block_cost * entries;
    }
    if (load.kinds == only(ChildKind::records) && load.count <= leaf_records_max) {
        return half_area * record_cost * entries;
    }
    if (load.kinds == only(ChildKind::instance) && load.count == 1) {
        return half_area * instance_cost;
    }
    return std::numeric_limits<float>::infinity();
}

/// Least cost as at most 1..8 roots.
using Costs = std::array<float, 8>;

/// How a node reaches its least costs.
class Plan {
public:
    /// True if the node becomes a leaf where it is a root of its own.
    [[nodiscard]] bool is_leaf() const { return (bits_ >> 28 & 1U) != 0; }
    /// True if a single root is the cheapest choice among 1 to `roots` roots.
    [[nodiscard]] bool is_one_root(std::uint32_t roots) const {
        return roots == 1 || (bits_ >> (19 + roots) & 1U) != 0;
    }
    /// How many of 2..8 roots the left child gets when the node is not a root of its own.
    [[nodiscard]] std::uint32_t left_roots(std::uint32_t roots) const {
        return bits_ >> (3 * (roots - 2)) & 7U;
    }

    void set_leaf() { bits_ |= 1U << 28; }
    void set_one_root(std::uint32_t roots) { bits_ |= 1U << (19 + roots); }
    void set_left_roots(std::uint32_t roots, std::uint32_t left) {
        bits_ |= left << (3 * (roots - 2));
    }

private:
    std::uint32_t bits_ = 0;
};

/// Plans a node over two planned children; `costs` receives its own.
Plan plan_cut(const Costs& left, const Costs& right, float as_leaf, float half_area, Costs& costs);

}  // namespace raynest::build
