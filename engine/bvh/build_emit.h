// Writes a planned binary tree as 8-wide nodes and leaves.
//
// Depth first, a node before its children: indices only grow downwards. Sizes are counted first, so
// that subtrees know their places and are written at the same time.
#pragma once

#include "engine/bvh/build.h"
#include "engine/bvh/build_binary.h"

namespace raynest::build {

/// Fills `order` of a node whose first `count` slots have children: for each octant, near to far.
/// Ranks are counted, not sorted: without branches eight slots take a few instructions each.
void order_children(Node& node, std::uint32_t count);

/// Fills nodes, leaves, root and height.
void emit(BinaryTree& binary, Tree& tree);

}  // namespace raynest::build
