// Builds the tables that name a scene's paths (geometry/path.h, FORMAT.md).
#pragma once

#include "engine/scene/content.h"
#include "engine/scene/description.h"
#include "engine/scene/graph.h"

#include <cstdint>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

namespace raynest {

/// Returns the name of an instance in path texts of a scene without nodes.
inline std::string step_name(const SceneDescription& scene, const InstanceDescription& instance) {
    return path_step_text(instance.name.empty() ? scene.objects[instance.object].name
                                                : instance.name);
}

/// Gives names small numbers: equal ones for equal names, 0 for the empty name.
class NameIds {
public:
    std::uint32_t of(const std::string& name) {
        return ids_.try_emplace(name, static_cast<std::uint32_t>(ids_.size())).first->second;
    }

private:
    std::unordered_map<std::string, std::uint32_t> ids_{{"", 0}};
};

/// Returns the first number of each sibling whose name is repeated or empty, no_id for others.
/// Equal names have equal ids in `names`, the empty name 0. `counts` tells how many numbers each
/// sibling takes; empty: one each.
std::vector<std::uint32_t> number_siblings(std::span<const std::uint32_t> names,
                                           std::span<const std::uint32_t> counts = {});

/// Returns the same for all nodes of a tree.
std::vector<std::uint32_t> number_nodes(const std::vector<PathNodeDescription>& nodes,
                                        std::span<const std::uint32_t> names);

/// Adds the tree of named nodes, if the description has one.
void add_path_nodes(const SceneDescription& description, const Graph& graph, Content& content);

}  // namespace raynest
