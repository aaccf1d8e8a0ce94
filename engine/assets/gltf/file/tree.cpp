// The shape of the node graph: glTF allows a forest, and everything else is refused here.
#include "engine/assets/gltf/file/model.h"

#include <fmt/format.h>

#include <algorithm>

namespace raynest::gltf {

Result<std::uint32_t> optional_index(std::int64_t value, std::size_t size, std::string_view what) {
    if (value == -1) return no_id;
    if (value < 0 || static_cast<std::uint64_t>(value) >= size) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("the scene refers to {} {}, but there are {}", what, value, size));
    }
    return static_cast<std::uint32_t>(value);
}

Result<std::uint32_t> required_index(std::int64_t value, std::size_t size, std::string_view what) {
    if (value != -1) return optional_index(value, size, what);
    return fail(ErrorCode::scene_invalid,
                fmt::format("the scene refers to {} -1, but there are {}", what, size));
}

namespace {

/// Sets model.roots to the listed nodes, except those that have an ancestor in the list.
Result<void> place_listed(Model& model, const std::vector<int>& listed,
                          const std::vector<std::uint32_t>& parents_first,
                          std::vector<bool>& in_scene) {
    for (const int node : listed) {
        const auto index = required_index(node, model.nodes.size(), "scene node");
        if (!index) return error_of(index);
        if (!in_scene[*index]) model.roots.push_back(*index);
        in_scene[*index] = true;
    }
    std::vector<bool> has_parent(model.nodes.size(), false);
    std::vector<bool> is_below(model.nodes.size(), false);
    for (const std::uint32_t node : parents_first) {
        for (const std::uint32_t child : model.nodes[node].children) {
            has_parent[child] = true;
            is_below[child] = in_scene[node];
            in_scene[child] = in_scene[child] || in_scene[node];
        }
    }
    std::erase_if(model.roots, [&](std::uint32_t node) { return is_below[node]; });
    if (const std::size_t again = listed.size() - model.roots.size(); again != 0) {
        model.warnings.push_back(fmt::format(
            "the scene lists nodes that it already has, {} of them; each is shown once", again));
    }
    const auto inner = std::count_if(model.roots.begin(), model.roots.end(),
                                     [&](std::uint32_t node) { return has_parent[node]; });
    if (inner != 0) {
        model.warnings.push_back(fmt::format(
            "the scene lists nodes without their parents, {} of them; each is placed by "
            "its own transform",
            inner));
    }
    return {};
}

/// Hides the meshes of hidden nodes and of all nodes below them (KHR_node_visibility). The nodes
/// stay, because skins may be bound to them, and so do cameras.
void hide(Model& model, const std::vector<std::uint32_t>& parents_first,
          const std::vector<bool>& in_scene) {
    for (const std::uint32_t index : parents_first) {
        Node& node = model.nodes[index];
        if (node.visible) continue;
        for (const std::uint32_t child : node.children) model.nodes[child].visible = false;
        if (node.mesh != no_id && in_scene[index])
            model.hidden_instances += std::max(node.instancing.count, 1U);
        node.mesh = no_id;
    }
}

}  // namespace

Result<void> set_roots(Model& model, const std::vector<int>* listed) {
    std::vector<bool> placed(model.nodes.size(), false);
    for (std::size_t i = 0; i < model.nodes.size(); ++i) {
        for (const std::uint32_t child : model.nodes[i].children) {
            if (child == i) {
                return fail(ErrorCode::scene_invalid,
                            fmt::format("node {} is its own child; a glTF scene is a tree", child));
            }
            if (placed[child]) {
                return fail(
                    ErrorCode::scene_invalid,
                    fmt::format("node {} has more than one parent; a glTF scene is a tree", child));
            }
            placed[child] = true;
        }
    }

    // With one parent each, nodes that no parentless node reaches lie on or below a cycle.
    std::vector<std::uint32_t> orphans;
    for (std::uint32_t i = 0; i < model.nodes.size(); ++i) {
        if (!placed[i]) orphans.push_back(i);
    }
    std::vector<std::uint32_t> order = orphans;  // parents before children
    order.reserve(model.nodes.size());
    for (std::size_t i = 0; i < order.size(); ++i) {
        const std::vector<std::uint32_t>& children = model.nodes[order[i]].children;
        order.insert(order.end(), children.begin(), children.end());
    }
    if (order.size() != model.nodes.size()) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("{} nodes of the scene are their own ancestors",
                                model.nodes.size() - order.size()));
    }

    std::vector<bool> in_scene(model.nodes.size(), listed == nullptr);
    if (listed == nullptr)
        model.roots = std::move(orphans);
    else if (auto done = place_listed(model, *listed, order, in_scene); !done)
        return done;
    hide(model, order, in_scene);
    return {};
}

std::vector<PlacedNode> nodes_with(const Model& model, std::uint32_t Node::*what) {
    std::vector<PlacedNode> found;
    std::vector<PlacedNode> stack;
    for (const std::uint32_t root : model.roots) stack.push_back({root, model.nodes[root].local});
    while (!stack.empty()) {
        const PlacedNode entry = stack.back();
        stack.pop_back();
        const Node& node = model.nodes[entry.node];
        if (node.*what != no_id) found.push_back(entry);
        for (const std::uint32_t child : node.children)
            stack.push_back({child, multiply(entry.to_scene, model.nodes[child].local)});
    }
    std::sort(found.begin(), found.end(),
              [](const PlacedNode& a, const PlacedNode& b) { return a.node < b.node; });
    return found;
}

}  // namespace raynest::gltf
