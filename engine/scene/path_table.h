// What names the paths of a scene, on its way into an arena (geometry/path.h, FORMAT.md).
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

/// What texts call an instance in a scene without nodes.
inline std::string step_name(const SceneDescription& scene, const InstanceDescription& instance) {
    return path_step_text(instance.name.empty() ? scene.objects[instance.object].name
                                                : instance.name);
}

/// Small numbers for names, equal ones for equal names and 0 for the empty one.
class NameIds {
public:
    std::uint32_t of(const std::string& name) {
        return ids_.try_emplace(name, static_cast<std::uint32_t>(ids_.size())).first->second;
    }

private:
    std::unordered_map<std::string, std::uint32_t> ids_{{"", 0}};
};

/// The first number of each sibling whose name is repeated or empty, no_id of the others. Equal
/// names have equal ids in `names`, the empty one 0; `counts` says how many numbers each takes, one
/// where it is empty.
std::vector<std::uint32_t> number_siblings(std::span<const std::uint32_t> names,
                                           std::span<const std::uint32_t> counts = {});

/// The same for all nodes of a tree.
std::vector<std::uint32_t> number_nodes(const std::vector<PathNodeDescription>& nodes,
                                        std::span<const std::uint32_t> names);

/// Adds the tree of named nodes, if the description has one.
void add_path_nodes(const SceneDescription& description, const Graph& graph, Content& content);

}  // namespace raynest
