// Statistics of a scene's trees, computed from the trees: they need no space in the arena and
// cannot contradict it.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// Costs of the children of some nodes times their areas: of other nodes, and of what leaves hold.
struct CostShares {
    double nodes = 0, leaves = 0;
    [[nodiscard]] double sum() const { return nodes + leaves; }
    CostShares& operator+=(const CostShares& other) {
        nodes += other.nodes;
        leaves += other.leaves;
        return *this;
    }
    CostShares& operator-=(const CostShares& other) {
        nodes -= other.nodes;
        leaves -= other.leaves;
        return *this;
    }
};

struct TreeStatistics {
    /// Expected cost of a ray that meets the scene's box, in node visits: the surface area
    /// heuristic with the builder's costs (bvh/build_cut.h), through all levels of instances.
    double sah_cost = 0;
    std::uint32_t height = 0;  ///< nodes on the longest path of the highest tree
    CostShares shares = {};
};

/// Measures the trees of a checked scene, in linear time.
TreeStatistics measure_trees(const SceneView& scene);
/// The same for each object's tree, with the trees of its instances in the cost.
std::vector<TreeStatistics> measure_each_tree(const SceneView& scene);
/// Returns the shares of one node. `costs` are those of all objects.
CostShares cost_shares(const SceneView& scene, const ObjectRecord& object, const Node& node,
                       std::span<const double> costs);
/// The same for all nodes of an object.
CostShares cost_shares(const SceneView& scene, const ObjectRecord& object,
                       std::span<const double> costs);
/// Returns the expected cost of an object from the shares of its nodes.
double cost_of(const SceneView& scene, const ObjectRecord& object, const CostShares& shares,
               std::span<const double> costs);

/// An object's tree when it was last built.
struct TreeBuild {
    CostShares shares;
    double area = 0;  ///< of its box; 0: nothing is known
};
TreeBuild tree_build(const Box& bounds, const CostShares& shares);
/// True if a tree costs so many times as much as when it was built,
///   - for rays through the smaller one of its two boxes: then one part that is far away neither
///     hides that nor is worth waiting for; or
///   - in units of what its leaves cost: these became cheap, and a new tree would, too.
bool has_grown(const TreeBuild& built, const TreeBuild& now, double factor);

}  // namespace raynest
