#include "engine/scene/selected_instances.h"

#include <algorithm>
#include <string>

namespace raynest {
namespace {

Result<void> check_each(std::span<const std::uint32_t> chosen, std::uint32_t count,
                        const char* what) {
    const auto absent =
        std::ranges::find_if(chosen, [&](std::uint32_t index) { return index >= count; });
    if (absent == chosen.end()) return {};
    return fail(ErrorCode::field_invalid, "there is no " + std::string(what) + " " +
                                              std::to_string(*absent) + ": the scene has " +
                                              std::to_string(count));
}

/// Objects that rays enter when only some are shown.
struct Kept {
    std::vector<bool> leading;  ///< chosen, or with a chosen one somewhere below
    std::vector<bool> inside;   ///< chosen, or placed in a chosen one
};

Kept keep(const SceneView& scene, std::span<const std::uint32_t> chosen) {
    Kept kept{std::vector<bool>(scene.object_count), std::vector<bool>(scene.object_count)};
    for (const std::uint32_t object : chosen) kept.leading[object] = kept.inside[object] = true;
    const auto for_children = [&](std::uint32_t object, auto&& call) {
        const ObjectRecord& record = scene.objects[object];
        for (std::uint32_t k = 0; k < record.instance_count; ++k)
            call(scene.instances[record.first_instance + k].object);
    };
    for (std::uint32_t i = 0; i < scene.object_count; ++i)  // children come first
        for_children(i, [&](std::uint32_t child) {
            if (kept.leading[child]) kept.leading[i] = true;
        });
    for (std::uint32_t i = scene.object_count; i-- > 0;)
        if (kept.inside[i])
            for_children(i, [&](std::uint32_t child) { kept.inside[child] = true; });
    return kept;
}

/// Takes the slots out of a tree that lead to hidden instances alone.
class Pruning {
public:
    Pruning(std::span<Node> nodes, std::span<const InstanceRecord> instances)
        : nodes_(nodes),
          instances_(instances) {}

    /// True if anything below a child word can be entered. Trees are at most tree_height_max high.
    bool keeps(std::uint32_t child) {
        if (is_leaf(child))
            return kind_of(child) != ChildKind::instance ||
                   instances_[leaf_instance(child)].mask != 0;
        Node& node = nodes_[child];
        const std::uint32_t valid = node.valid();
        std::uint32_t kept = 0;
        for (std::uint32_t slot = 0; slot < 8; ++slot) {
            if ((valid >> slot & 1U) == 0) continue;
            if (keeps(node.child[slot]))
                kept |= 1U << slot;
            else
                node.child[slot] = child_empty;
        }
        node.order[0] = (node.order[0] & 0xFFFFFFU) | kept << 24;
        return kept != 0;
    }

private:
    std::span<Node> nodes_;
    std::span<const InstanceRecord> instances_;
};

/// Fails where one of `hidden` is also one of `shown`.
Result<void> check_contradiction(std::span<const std::uint32_t> hidden,
                                 std::span<const std::uint32_t> shown, const char* what) {
    const auto both = std::ranges::find_if(hidden, [&](std::uint32_t index) {
        return std::ranges::find(shown, index) != shown.end();
    });
    if (both == hidden.end()) return {};
    return fail(ErrorCode::field_invalid, "`hide` and `only` both name " + std::string(what) + " " +
                                              std::to_string(*both) +
                                              ": leave it out of one of them");
}

}  // namespace

Result<void> SelectedInstances::check(const SceneView& scene, const InstanceSelection& selection) {
    const ObjectRecord& root = scene.objects[scene.root];
    for (const auto chosen : {selection.hidden_instances, selection.only_instances})
        if (auto known = check_each(chosen, root.instance_count, "outermost instance"); !known)
            return known;
    for (const auto chosen : {selection.hidden_objects, selection.only_objects})
        if (auto known = check_each(chosen, scene.object_count, "object"); !known) return known;
    if (auto clear = check_contradiction(selection.hidden_instances, selection.only_instances,
                                         "outermost instance");
        !clear)
        return clear;
    return check_contradiction(selection.hidden_objects, selection.only_objects, "object");
}

Result<std::vector<InstanceRecord>> SelectedInstances::select(const SceneView& scene,
                                                              const InstanceSelection& selection) {
    if (const auto known = check(scene, selection); !known) return tl::unexpected(known.error());
    const ObjectRecord& root = scene.objects[scene.root];

    std::vector<InstanceRecord> instances(scene.instances, scene.instances + scene.instance_count);
    const auto outermost = std::span(instances).subspan(root.first_instance, root.instance_count);
    if (!selection.only_instances.empty()) {
        std::vector<bool> shown(outermost.size());
        for (const std::uint32_t index : selection.only_instances) shown[index] = true;
        for (std::size_t i = 0; i < outermost.size(); ++i)
            if (!shown[i]) outermost[i].mask = 0;
    }
    for (const std::uint32_t index : selection.hidden_instances) outermost[index].mask = 0;
    if (!selection.only_objects.empty()) {
        const Kept kept = keep(scene, selection.only_objects);
        for (std::uint32_t i = 0; i < scene.object_count; ++i) {
            if (kept.inside[i]) continue;
            const ObjectRecord& object = scene.objects[i];
            for (std::uint32_t k = 0; k < object.instance_count; ++k) {
                InstanceRecord& instance = instances[object.first_instance + k];
                if (!kept.leading[instance.object]) instance.mask = 0;
            }
        }
    }
    std::vector<bool> hidden(scene.object_count);
    for (const std::uint32_t object : selection.hidden_objects) hidden[object] = true;
    for (InstanceRecord& instance : instances)
        if (hidden[instance.object]) instance.mask = 0;
    return instances;
}

std::uint64_t SelectedInstances::node_count(const SceneView& scene) {
    std::uint64_t count = 0;
    for (std::uint32_t i = 0; i < scene.object_count; ++i)
        count = std::max(count, scene.objects[i].first_node + scene.objects[i].node_count);
    return count;
}

std::vector<Node> SelectedInstances::prune(const SceneView& scene,
                                           std::span<const InstanceRecord> instances) {
    std::vector<Node> nodes(scene.nodes, scene.nodes + node_count(scene));
    for (std::uint32_t i = 0; i < scene.object_count; ++i) {
        const ObjectRecord& object = scene.objects[i];
        if (object.instance_count == 0) continue;
        Pruning(std::span(nodes).subspan(object.first_node, object.node_count),
                instances.subspan(object.first_instance, object.instance_count))
            .keeps(object.root);
    }
    return nodes;
}

}  // namespace raynest
