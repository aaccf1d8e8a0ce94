// Masks of placements in a glTF scene.
#pragma once

#include "engine/assets/gltf/file/model.h"
#include "engine/assets/input/mask_rules.h"

#include <cstdint>
#include <unordered_map>
#include <vector>

namespace raynest::gltf {

/// Masks by node, or by placement if those of one node may differ.
struct Masks {
    std::vector<std::uint32_t> by_node;  ///< empty if all are mask_all
    std::unordered_map<std::uint32_t, std::vector<std::uint32_t>> by_placement;

    [[nodiscard]] bool is_by_placement(std::uint32_t node) const {
        return by_placement.contains(node);
    }
    [[nodiscard]] std::uint32_t of(std::uint32_t node, std::uint32_t placement) const;
};

/// Computes the masks. `order` lists the nodes of the scene, parents before children. `scene`
/// already has its path nodes, and receives a warning for each rule that matches nothing.
Result<Masks> read_masks(const Model& model, const std::vector<std::uint32_t>& order,
                         MaskRules& rules, SceneDescription& scene);

}  // namespace raynest::gltf
