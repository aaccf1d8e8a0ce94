#include "engine/scene/placed_box.h"

#include "engine/scene/farthest.h"

#include <algorithm>
#include <cstddef>
#include <limits>

namespace raynest {
namespace {

/// The trees of a scene that is being built.
class BuiltTrees {
public:
    explicit BuiltTrees(const Content& content) : content_(content) {}

    [[nodiscard]] ObjectTree tree(std::uint32_t object) const {
        const Tree& tree = content_.trees[object];
        return {tree.nodes.data(), tree.root, static_cast<std::uint32_t>(tree.nodes.size()),
                tree.bounds};
    }
    [[nodiscard]] TreePlacement placement(std::uint32_t object, std::uint32_t place) const {
        const std::size_t instance = content_.objects[object].first_instance + place;
        return {content_.instances[instance].object, content_.instance_infos[instance].to_parent};
    }
    [[nodiscard]] double padding(std::uint32_t object, std::uint32_t place) const {
        return content_.instance_paddings[content_.objects[object].first_instance + place];
    }
    /// Returns the extent of a leaf: of its triangles' vertices, or of its records' boxes.
    [[nodiscard]] double farthest_in_leaf(std::uint32_t object, std::uint32_t leaf,
                                          const Reach& reach, double /*most*/) const {
        const ObjectDescription& source = *content_.sources[object];
        const Tree& tree = content_.trees[object];
        double farthest = -std::numeric_limits<double>::infinity();
        if (kind_of(leaf) == ChildKind::records) {
            for (std::uint32_t i = 0; i < leaf_count(leaf); ++i) {
                const std::uint32_t record = tree.record_order[leaf_first(leaf) + i];
                farthest = std::max(farthest, reach.of(source.record_bounds[record]));
            }
            return farthest;
        }
        const std::size_t first = std::size_t{8} * leaf_first(leaf);
        for (std::size_t lane = first; lane < first + 8 * leaf_count(leaf); ++lane) {
            std::size_t triangle = tree.block_lanes[lane];
            if (triangle == no_id) continue;
            auto geometry = source.geometries.begin();
            for (; triangle >= geometry->indices.size() / 3; ++geometry)
                triangle -= geometry->indices.size() / 3;
            for (std::size_t corner = 0; corner < 3; ++corner) {
                const Vec3& point = geometry->positions[geometry->indices[3 * triangle + corner]];
                farthest = std::max(farthest, reach.of(Box{point, point}));
            }
        }
        return farthest;
    }

private:
    const Content& content_;
};

}  // namespace

bool in_range(const Box& box) {
    if (box.is_empty()) return true;
    const Vec3 reach = glm::max(glm::abs(box.lower), glm::abs(box.upper));
    return std::max({reach.x, reach.y, reach.z}) <= coordinate_max;
}

float placement_error(const Transform& to_parent, float child_error) {
    // The limit keeps the arithmetic finite; beyond it the box test enters every box anyway.
    constexpr float origin_error_max = 1e30F;
    return std::min(condition(to_parent) * (1 + child_error), origin_error_max);
}

PlacedBox placed_box(const Content& content, std::uint32_t child, const Transform& to_parent,
                     float error) {
    return place_box(BuiltTrees(content), child, to_parent, error);
}

Box scene_bounds(const Content& content) {
    return vertex_bounds(BuiltTrees(content),
                         static_cast<std::uint32_t>(content.objects.size() - 1),
                         content.instances.size());
}

}  // namespace raynest
