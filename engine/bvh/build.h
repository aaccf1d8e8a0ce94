// Builds the 8-wide tree of one object.
//
//   boxes ──build_binary──► binary tree ──build_emit──► 8-wide nodes, leaves
//            │ where to split: build_split (binned SAH)
//            └ how to collapse: build_cut (cheapest cut), on the way back up
//
// Parallel (oneTBB, in the caller's arena) and deterministic: the same input gives the same bytes,
// for any number of threads.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/box.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// Items are numbered triangles or records first, never both kinds (ObjectRecord), then instances.
/// An item with an empty or non-finite box is left out of the tree: it can never be hit.
struct TreeInput {
    std::span<const Box> boxes;
    std::uint32_t triangle_count = 0;
    std::uint32_t record_count = 0;
    std::uint32_t instance_count = 0;  ///< boxes.size() is the sum of the three
};

struct Tree {
    std::vector<Node> nodes;
    std::uint32_t root = child_empty;  ///< child word; a tree without items stays empty
    Box bounds;
    /// Triangle of lane l of block b at [8 b + l], no_id in padding lanes. Within a block
    /// ascending.
    std::vector<std::uint32_t> block_lanes;
    /// Record at each place of the tree's record array.
    std::vector<std::uint32_t> record_order;
    double sah_cost = 0;
    std::uint32_t height = 0;  ///< nodes on the longest path
};

Tree build_tree(const TreeInput& input);

}  // namespace raynest
