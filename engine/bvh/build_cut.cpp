#include "engine/bvh/build_cut.h"

namespace raynest::build {

Plan plan_cut(const Costs& left, const Costs& right, float as_leaf, float half_area, Costs& costs) {
    Plan plan;
    for (std::uint32_t roots = 2; roots <= 8; ++roots) {
        float best = left[0] + right[roots - 2];
        std::uint32_t best_left = 1;
        for (std::uint32_t k = 2; k < roots; ++k) {
            const float cost = left[k - 1] + right[roots - k - 1];
            best_left = cost < best ? k : best_left;
            best = cost < best ? cost : best;
        }
        costs[roots - 1] = best;
        plan.set_left_roots(roots, best_left);
    }
    const float as_node = costs[7] + half_area * node_cost;
    const bool leaf = as_leaf <= as_node && as_leaf < std::numeric_limits<float>::infinity();
    if (leaf) plan.set_leaf();
    costs[0] = leaf ? as_leaf : as_node;
    for (std::uint32_t roots = 2; roots <= 8; ++roots) {
        if (costs[0] > costs[roots - 1]) continue;
        costs[roots - 1] = costs[0];
        plan.set_one_root(roots);
    }
    return plan;
}

}  // namespace raynest::build
