#include "engine/bvh/build.h"

#include "engine/bvh/build_binary.h"
#include "engine/bvh/build_emit.h"

#include <algorithm>

namespace raynest {

Tree build_tree(const TreeInput& input) {
    Tree tree;
    build::BinaryTree binary(input);
    if (binary.is_empty()) return tree;
    const float cost = binary.build();
    tree.bounds = binary.box();
    tree.sah_cost =
        static_cast<double>(cost) / std::max(static_cast<double>(tree.bounds.half_area()), 1e-30);
    build::emit(binary, tree);
    return tree;
}

}  // namespace raynest
