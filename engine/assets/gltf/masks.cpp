// Masks of placements: a node's own mask (extras.raynest.mask) applies to everything below it; mask
// rules of the load override it.
#include "engine/assets/gltf/masks.h"

#include "engine/scene/path_table.h"

#include <algorithm>

namespace raynest::gltf {

std::uint32_t Masks::of(std::uint32_t node, std::uint32_t placement) const {
    if (const auto own = by_placement.find(node); own != by_placement.end())
        return own->second[placement];
    return by_node.empty() ? mask_all : by_node[node];
}

Result<Masks> read_masks(const Model& model, const std::vector<std::uint32_t>& order,
                         MaskRules& rules, SceneDescription& scene) {
    Masks masks;
    const bool has_own = std::any_of(model.nodes.begin(), model.nodes.end(),
                                     [](const Node& node) { return node.mask.has_value(); });
    if (!has_own && rules.empty()) return masks;
    masks.by_node.assign(model.nodes.size(), mask_all);
    for (const std::uint32_t index : order) {
        const Node& node = model.nodes[index];
        if (node.mask) masks.by_node[index] = *node.mask;
        for (const std::uint32_t child : node.children) masks.by_node[child] = masks.by_node[index];
    }
    if (rules.empty()) return masks;

    const std::vector<PathNodeDescription>& nodes = scene.path_nodes;
    std::vector<std::string> texts;
    std::vector<std::uint32_t> names;
    NameIds ids;
    for (const PathNodeDescription& node : nodes) {
        texts.push_back(path_step_text(node.name));
        names.push_back(ids.of(texts.back()));
    }
    const std::vector<std::uint32_t> numbers = number_nodes(nodes, names);
    std::vector<MaskRules::State> states(nodes.size(), MaskRules::start());
    for (std::uint32_t i = 1; i < nodes.size(); ++i) {
        const PathNodeDescription& node = nodes[i];
        const auto step = [&](std::uint32_t number) {
            return rules.step(states[node.parent], numbered(texts[i], number), node.parent == 0);
        };
        const auto state = step(numbers[i]);
        if (!state) return error_of(state);
        states[i] = *state;
        const std::uint32_t own = masks.by_node[node.source];
        if (node.placements == 1) masks.by_node[node.source] = rules.mask(*state).value_or(own);
        if (node.placements <= 1) continue;
        std::vector<std::uint32_t> each;
        for (std::uint32_t k = 0; k < node.placements; ++k) {
            const auto placed = step(numbers[i] + k);
            if (!placed) return error_of(placed);
            each.push_back(rules.mask(*placed).value_or(own));
        }
        masks.by_placement.emplace(node.source, std::move(each));
    }
    rules.warn(scene);
    return masks;
}

}  // namespace raynest::gltf
