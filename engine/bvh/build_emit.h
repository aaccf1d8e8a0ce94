// Writes a planned binary tree as 8-wide nodes and leaves.
//
// Depth first, a node before its children: indices only grow downwards. Sizes are counted first, so
// that subtrees know their places and are written at the same time.
#pragma once

#include "engine/bvh/build.h"
#include "engine/bvh/build_binary.h"

namespace raynest::build {

/// Fills nodes, leaves, root and height.
void emit(BinaryTree& binary, Tree& tree);

}  // namespace raynest::build
