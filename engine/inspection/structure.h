// How a scene is built, for tables and wireframes: its objects, its placements, the boxes of its
// trees.
#pragma once

#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

namespace raynest {

/// An object and its tree.
struct ObjectFacts {
    std::uint64_t placements = 0;  ///< ways from the root to the object; no more than 2^64 - 1
    std::uint64_t bytes = 0;       ///< its tree, triangles, records and instances
    std::uint32_t height = 0;      ///< nodes on the longest path of its tree
    double sah_cost = 0;           ///< as TreeStatistics, with the trees of its instances
    double overlap = 0;            ///< EPO (scene/tree_overlap.h)
    double box_share = 0;          ///< area of its triangles over half that of their boxes
};

/// Describes the objects [first, first + count); fewer where the scene has fewer. Linear in the
/// scene.
[[nodiscard]] std::vector<ObjectFacts> object_facts(const Snapshot& scene, std::uint64_t first,
                                                    std::size_t count);

/// One placement: the instances on its way, and where it lies.
struct PlacementFacts {
    std::uint64_t path = 0;
    std::uint32_t object = no_id;
    std::uint32_t outermost = no_id;  ///< its outermost instance's place in the root
    std::uint32_t mask = no_id;       ///< its innermost instance's
    std::uint32_t depth = 0;          ///< number of instances on the way
    Transform to_scene;
};

/// Describes the placements of paths [first, first + count); fewer where the scene has fewer.
[[nodiscard]] std::vector<PlacementFacts> placement_facts(const SceneView& scene,
                                                          std::uint64_t first, std::size_t count);

/// Boxes of a tree: those with a depth (number of nodes above) in a range.
struct TreeBox {
    std::uint32_t depth = 0;
    bool is_leaf = false;
    Box box;
};
struct PlacedTree {
    std::uint64_t path = 0;  ///< its first placement
    std::uint32_t object = no_id;
    Transform to_scene;
    std::vector<TreeBox> boxes;
};
struct BoxRequest {
    std::uint32_t level = 0;
    std::uint32_t depth_min = 0;
    std::uint32_t depth_max = 0;
    std::size_t count = 0;         ///< boxes, at most
    std::uint64_t path = no_path;  ///< if not no_path: only the tree on the way to that placement
};
struct TreeBoxes {
    std::vector<PlacedTree> trees;
    bool complete = true;  ///< false: some were left out
};
/// Collects boxes level by level of each tree, in the order of the trees' paths. Stops early, as
/// incomplete, once `stop` returns true.
[[nodiscard]] TreeBoxes tree_boxes(const SceneView& scene, const BoxRequest& request,
                                   const std::function<bool()>& stop);

}  // namespace raynest
