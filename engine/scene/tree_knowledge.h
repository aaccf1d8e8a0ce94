// Knowledge of a scene's trees beside the arena, so that an edit need not look at all of them: the
// ways up from instances to the roots, expected costs, and how far nodes reach.
#pragma once

#include "engine/bvh/node.h"
#include "engine/geometry/views.h"
#include "engine/scene/tree_statistics.h"

#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <vector>

namespace raynest {

/// The ways up in an object's tree. They stay the same while it is refitted.
struct TreeLinks {
    std::vector<std::uint32_t> parents;  ///< of each node; no_id of the root
    std::vector<std::uint32_t>
        holders;  ///< the node that has each instance as a leaf; no_id: none has
};

/// In linear time.
inline TreeLinks links_of(const SceneView& view, const ObjectRecord& object) {
    TreeLinks links{std::vector(object.node_count, no_id),
                    std::vector(object.instance_count, no_id)};
    for (std::uint32_t i = 0; i < object.node_count; ++i) {
        for (const std::uint32_t child : view.nodes[object.first_node + i].child) {
            if (child == child_empty) continue;
            if (!is_leaf(child))
                links.parents[child] = i;
            else if (kind_of(child) == ChildKind::instance)
                links.holders[leaf_instance(child)] = i;
        }
    }
    return links;
}

/// Upper bounds of the extents of nodes along one direction, in the spaces of their objects, as exact
/// searches find them (scene/farthest.h). In a flat field every part lies at a side of the box: a
/// search looks at all of them once, and later ones at those alone that have moved. Not thread-safe.
class KnownExtents {
public:
    /// Smaller trees are searched as fast.
    static constexpr std::uint32_t nodes_min = 32;

    /// Returns those of an object's nodes; infinity: nothing is known. Stays where it is.
    std::vector<double>& of(std::uint32_t object, std::uint32_t node_count) {
        std::vector<double>& extents = extents_[object];
        extents.resize(node_count, unknown);
        return extents;
    }
    void forget(std::uint32_t object) { extents_.erase(object); }
    void forget(std::uint32_t object, std::uint32_t node) {
        if (const auto known = extents_.find(object); known != extents_.end())
            known->second[node] = unknown;
    }
    /// Nodes and instances that searches have opened so far.
    [[nodiscard]] std::uint64_t opened() const { return opened_; }
    void count(std::uint64_t opened) { opened_ += opened; }

private:
    static constexpr double unknown = std::numeric_limits<double>::infinity();
    std::map<std::uint32_t, std::vector<double>> extents_;
    std::uint64_t opened_ = 0;
};

/// Those along all sides of a box, which searches may use at the same time.
struct KnownBox {
    std::array<KnownExtents, 6> sides;

    void forget(std::uint32_t object) {
        for (KnownExtents& side : sides) side.forget(object);
    }
    void forget(std::uint32_t object, std::uint32_t node) {
        for (KnownExtents& side : sides) side.forget(object, node);
    }
    [[nodiscard]] std::uint64_t opened() const {
        std::uint64_t sum = 0;
        for (const KnownExtents& side : sides) sum += side.opened();
        return sum;
    }
};

struct TreeKnowledge {
    /// By object, for those in which few of many instances have changed.
    std::map<std::uint32_t, std::shared_ptr<const TreeLinks>> links;
    std::vector<double> costs;       ///< by object (TreeStatistics::sah_cost)
    std::vector<CostShares> shares;  ///< by object
    std::shared_ptr<KnownBox> extents;
    std::shared_ptr<const std::vector<TreeBuild>> built;  ///< by object
};

}  // namespace raynest
