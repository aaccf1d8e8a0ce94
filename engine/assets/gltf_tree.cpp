// The shape of the node graph: glTF allows a forest, and nothing else may get further.
#include "engine/assets/gltf_model.h"

#include <fmt/format.h>

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

    // With one parent each, nodes that no parentless node reaches stand on a cycle.
    std::vector<std::uint32_t> orphans;
    for (std::uint32_t i = 0; i < model.nodes.size(); ++i) {
        if (!placed[i]) orphans.push_back(i);
    }
    std::vector<std::uint32_t> stack = orphans;
    std::size_t reached = 0;
    while (!stack.empty()) {
        const std::vector<std::uint32_t>& children = model.nodes[stack.back()].children;
        stack.pop_back();
        ++reached;
        stack.insert(stack.end(), children.begin(), children.end());
    }
    if (reached != model.nodes.size()) {
        return fail(ErrorCode::scene_invalid,
                    fmt::format("{} nodes of the scene are their own ancestors",
                                model.nodes.size() - reached));
    }

    if (listed == nullptr) {
        model.roots = std::move(orphans);
        return {};
    }
    for (const int node : *listed) {
        const auto index = required_index(node, model.nodes.size(), "scene node");
        if (!index) return error_of(index);
        if (placed[*index]) {
            return fail(ErrorCode::scene_invalid,
                        fmt::format("the scene lists node {}, which stands elsewhere too", *index));
        }
        placed[*index] = true;
        model.roots.push_back(*index);
    }
    return {};
}

}  // namespace raynest::gltf
