#include "engine/scene/tree_statistics.h"

#include "engine/bvh/build_cut.h"
#include "engine/bvh/node.h"

#include <algorithm>
#include <utility>

namespace raynest {
namespace {

double area_of(const Box& box) {
    return box.is_empty() ? 0 : static_cast<double>(box.half_area());
}

double leaf_cost(const SceneView& scene, const ObjectRecord& object, std::uint32_t leaf,
                 std::span<const double> costs) {
    if (leaf == child_empty) return 0;
    switch (kind_of(leaf)) {
        case ChildKind::triangles:
            return double{build::block_cost} * leaf_count(leaf);
        case ChildKind::records:
            return double{build::record_cost} * leaf_count(leaf);
        case ChildKind::instance: {
            const std::uint32_t instance = object.first_instance + leaf_instance(leaf);
            return double{build::instance_cost} + costs[scene.instances[instance].object];
        }
    }
    return 0;
}

class Measurer {
public:
    explicit Measurer(const SceneView& scene) : scene_(scene) {}

    std::vector<TreeStatistics> measure() {
        std::vector<TreeStatistics> all;
        for (std::uint32_t i = 0; i < scene_.object_count; ++i) {  // children come first
            const ObjectRecord& object = scene_.objects[i];
            const CostShares shares = cost_shares(scene_, object, cost_);
            cost_.push_back(cost_of(scene_, object, shares, cost_));
            all.push_back({cost_.back(), height_of(object), shares});
        }
        return all;
    }

private:
    std::uint32_t height_of(const ObjectRecord& object) {
        heights_.assign(object.node_count, 1);
        std::uint8_t height = object.node_count == 0 ? 0 : 1;
        for (std::uint32_t i = 0; i < object.node_count; ++i) {  // parents come first
            height = std::max(height, heights_[i]);
            for (const std::uint32_t child : scene_.nodes[object.first_node + i].child) {
                if (!is_leaf(child)) heights_[child] = static_cast<std::uint8_t>(heights_[i] + 1);
            }
        }
        return height;
    }

    const SceneView& scene_;
    std::vector<double> cost_;  ///< for the objects so far
    std::vector<std::uint8_t> heights_;
};

}  // namespace

CostShares cost_shares(const SceneView& scene, const ObjectRecord& object, const Node& node,
                       std::span<const double> costs) {
    CostShares shares;
    for (std::uint32_t slot = 0; slot < 8; ++slot) {
        const std::uint32_t child = node.child[slot];
        if (child == child_empty) continue;
        const double area =
            area_of({{node.lower[0][slot], node.lower[1][slot], node.lower[2][slot]},
                     {node.upper[0][slot], node.upper[1][slot], node.upper[2][slot]}});
        if (is_leaf(child))
            shares.leaves += leaf_cost(scene, object, child, costs) * area;
        else
            shares.nodes += double{build::node_cost} * area;
    }
    return shares;
}

CostShares cost_shares(const SceneView& scene, const ObjectRecord& object,
                       std::span<const double> costs) {
    CostShares shares;
    for (std::uint32_t i = 0; i < object.node_count; ++i)
        shares += cost_shares(scene, object, scene.nodes[object.first_node + i], costs);
    return shares;
}

double cost_of(const SceneView& scene, const ObjectRecord& object, const CostShares& shares,
               std::span<const double> costs) {
    const double area = area_of(object.bounds);
    if (object.node_count == 0 || !(area > 0)) return leaf_cost(scene, object, object.root, costs);
    return double{build::node_cost} + shares.sum() / area;
}

TreeBuild tree_build(const Box& bounds, const CostShares& shares) {
    return {shares, area_of(bounds)};
}

bool has_grown(const TreeBuild& built, const TreeBuild& now, double factor) {
    if (!(now.area > 0 && built.area > 0)) return false;
    const auto grew = [&](double of_now, double of_built) {
        return of_now > 0 && of_built > 0 &&
               now.shares.sum() / of_now > factor * built.shares.sum() / of_built;
    };
    return grew(std::min(now.area, built.area), built.area) ||
           grew(now.shares.leaves, built.shares.leaves);
}

std::vector<TreeStatistics> measure_each_tree(const SceneView& scene) {
    return Measurer(scene).measure();
}

TreeStatistics measure_trees(const SceneView& scene) {
    const std::vector<TreeStatistics> each = measure_each_tree(scene);
    TreeStatistics all{each[scene.root].sah_cost, 0};
    for (const TreeStatistics& tree : each) all.height = std::max(all.height, tree.height);
    return all;
}

}  // namespace raynest
