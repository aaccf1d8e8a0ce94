#include "engine/scene/edits/tree_links.h"

#include "engine/bvh/node.h"

namespace raynest {

TreeLinks links_of(const SceneView& view, const ObjectRecord& object) {
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

}  // namespace raynest
