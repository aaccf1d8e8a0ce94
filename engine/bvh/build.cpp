#include "engine/bvh/build.h"

#include "engine/bvh/build_binary.h"
#include "engine/bvh/build_emit.h"

#include <algorithm>

#ifdef __SANITIZE_THREAD__
#include <tbb/global_control.h>
#endif

namespace raynest {

#ifdef __SANITIZE_THREAD__
// oneTBB's library is not compiled with the checks: how its threads hand work to each other is not
// seen, and each hand-over looks like a race. To suppress the reports is no way out: looking each
// up took 99 % of the time of a build. One thread hands nothing over.
static const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
#endif

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
