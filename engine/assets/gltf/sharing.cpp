#include "engine/assets/gltf/sharing.h"

#include <algorithm>
#include <string>
#include <unordered_map>

namespace raynest::gltf {
namespace {

template <class T>
void append(std::string& key, const T& value) {
    key.append(reinterpret_cast<const char*>(&value), sizeof value);
}

}  // namespace

Sharing find_sharing(const Model& model, const std::vector<std::uint32_t>& order,
                     const std::vector<bool>& traceable, const Masks& masks) {
    Sharing sharing;
    sharing.shape_of.assign(model.nodes.size(), no_id);
    std::unordered_map<std::string, std::uint32_t> known;
    std::string key;
    for (auto at = order.rbegin(); at != order.rend(); ++at) {
        const Node& node = model.nodes[*at];
        Shape shape{0, 0, 0, *at};
        key.clear();
        const bool places_mesh = node.mesh != no_id && traceable[node.mesh];
        if (places_mesh) {
            shape.placements = std::max(node.instancing.count, 1U);
            shape.in_scene_space = node.skin != no_id;
            append(key, node.mesh);
            append(key, node.instancing.translation);
            append(key, node.instancing.rotation);
            append(key, node.instancing.scale);
            // Add one mask, or one per placement; equal accessors have the same number of
            // placements.
            const bool one_each = masks.is_by_placement(*at);
            append(key, one_each);
            for (std::uint32_t i = 0; i < (one_each ? shape.placements : 1); ++i)
                append(key, masks.of(*at, i));
        }
        for (const std::uint32_t child : node.children) {
            const std::uint32_t of_child = sharing.shape_of[child];
            if (of_child == no_id) continue;
            shape.placements += sharing.shapes[of_child].placements;
            const bool moves = model.nodes[child].is_animated;
            shape.in_scene_space =
                shape.in_scene_space || moves || sharing.shapes[of_child].in_scene_space;
            append(key, moves);
            append(key, model.nodes[child].local);
            append(key, of_child);
        }
        if (key.empty()) continue;
        // A mesh's part of the key is 17 bytes and more, and a child's is 101: one flag tells them
        // apart.
        key.push_back(places_mesh ? '\1' : '\0');

        const auto number = static_cast<std::uint32_t>(sharing.shapes.size());
        const auto [entry, is_new] = known.try_emplace(key, number);
        sharing.shape_of[*at] = entry->second;
        if (is_new) {
            sharing.shapes.push_back(shape);
            for (const std::uint32_t child : node.children) {
                if (sharing.shape_of[child] != no_id)
                    ++sharing.shapes[sharing.shape_of[child]].uses;
            }
        } else {
            // The walk goes backwards, so the last node seen is the first in depth-first order.
            sharing.shapes[entry->second].example = *at;
        }
    }
    for (const std::uint32_t root : model.roots) {
        if (sharing.shape_of[root] != no_id) ++sharing.shapes[sharing.shape_of[root]].uses;
    }
    // All uses are known, and children come first, so each shape knows whether it becomes an
    // object.
    for (Shape& shape : sharing.shapes) {
        const Node& node = model.nodes[shape.example];
        if (node.mesh != no_id && traceable[node.mesh]) shape.levels = 1;
        for (const std::uint32_t child : node.children) {
            if (sharing.shape_of[child] == no_id) continue;
            const Shape& below = sharing.shapes[sharing.shape_of[child]];
            shape.levels = std::max(shape.levels, below.levels + (below.is_shared() ? 1U : 0U));
        }
    }
    return sharing;
}

}  // namespace raynest::gltf
