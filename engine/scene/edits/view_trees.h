// The trees of a finished scene, for searches of extents (scene/farthest.h).
#pragma once

#include "engine/geometry/triangle.h"
#include "engine/geometry/views.h"
#include "engine/scene/farthest.h"
#include "engine/scene/placed_box.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace raynest {

class ViewTrees {
public:
    explicit ViewTrees(const SceneView& view) : view_(view) {}

    [[nodiscard]] ObjectTree tree(std::uint32_t object) const {
        const ObjectRecord& record = view_.objects[object];
        return {view_.nodes + record.first_node, record.root, record.node_count, record.bounds};
    }
    [[nodiscard]] TreePlacement placement(std::uint32_t object, std::uint32_t place) const {
        const std::size_t instance = view_.objects[object].first_instance + place;
        const std::uint32_t child = view_.instances[instance].object;
        return {child, view_.instance_infos[instance].to_parent};
    }
    [[nodiscard]] double padding(std::uint32_t object, std::uint32_t place) const {
        const auto [child, to_parent] = placement(object, place);
        const ObjectRecord& record = view_.objects[child];
        return placed_padding(record.bounds, to_parent,
                              placement_error(to_parent, record.origin_error));
    }
    /// Records have no box of their own any more: what is known of their leaf counts.
    [[nodiscard]] double farthest_in_leaf(std::uint32_t object, std::uint32_t leaf,
                                          const Reach& reach, double most) const {
        if (kind_of(leaf) == ChildKind::records) return most;
        double farthest = -std::numeric_limits<double>::infinity();
        const TriangleBlock* const first =
            view_.blocks + view_.objects[object].first_block + leaf_first(leaf);
        for (const TriangleBlock* block = first; block != first + leaf_count(leaf); ++block) {
            for (std::size_t lane = 0; lane < 8; ++lane) {
                if (block->triangle[lane] == no_id) continue;
                for (const auto& corner : block->vertex) {
                    const Vec3 point(corner[0][lane], corner[1][lane], corner[2][lane]);
                    farthest = std::max(farthest, reach.of(Box{point, point}));
                }
            }
        }
        return farthest;
    }

private:
    const SceneView& view_;
};

}  // namespace raynest
