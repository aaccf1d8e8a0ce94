// Statistics of a scene's trees, computed from the trees: they need no space in the arena and
// cannot contradict it.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

struct TreeStatistics {
    /// Expected cost of a ray that meets the scene's box, in node visits: the surface area
    /// heuristic with the builder's costs (bvh/build_cut.h), through all levels of instances.
    double sah_cost = 0;
    std::uint32_t height = 0;  ///< nodes on the longest path of the highest tree
};

/// Measures the trees of a checked scene, in linear time.
TreeStatistics measure_trees(const SceneView& scene);
/// The same for each object's tree, with the trees of its instances in the cost.
std::vector<TreeStatistics> measure_each_tree(const SceneView& scene);
/// Returns the part of a node in the cost of its object: SAH costs of its children times their
/// areas. `costs` are those of all objects.
double cost_share(const SceneView& scene, const ObjectRecord& object, const Node& node,
                  std::span<const double> costs);
/// Returns the cost of an object from the sum of the shares of its nodes, and the sum from the
/// cost.
double cost_of_shares(const Box& bounds, double sum);
double shares_of_cost(const Box& bounds, double cost);

/// An object's tree when it was last built: the sum of the shares of its nodes, and the area of its
/// box.
struct TreeBuild {
    double shares = 0;
    double area = 0;  ///< 0: nothing is known
};
TreeBuild tree_build(const Box& bounds, double cost);
/// True if a tree costs so many times as much as when it was built, for rays through the smaller one
/// of its two boxes: then one part that is far away neither hides that nor is worth waiting for.
bool has_grown(const TreeBuild& built, const Box& bounds, double cost, double factor);

/// Returns the cost of an object; `costs` are those of what it places.
double tree_cost(const SceneView& scene, const ObjectRecord& object, std::span<const double> costs);

}  // namespace raynest
