#include "engine/scene/selected_instances.h"

#include <algorithm>
#include <string>

namespace raynest {
namespace {

Result<void> check(std::span<const std::uint32_t> chosen, std::uint32_t count, const char* what) {
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

}  // namespace

Result<std::vector<InstanceRecord>> SelectedInstances::select(const SceneView& scene,
                                                              const InstanceSelection& selection) {
    const ObjectRecord& root = scene.objects[scene.root];
    for (const auto chosen : {selection.hidden_instances, selection.only_instances})
        if (const auto known = check(chosen, root.instance_count, "outermost instance"); !known)
            return tl::unexpected(known.error());
    for (const auto chosen : {selection.hidden_objects, selection.only_objects})
        if (const auto known = check(chosen, scene.object_count, "object"); !known)
            return tl::unexpected(known.error());

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

}  // namespace raynest
