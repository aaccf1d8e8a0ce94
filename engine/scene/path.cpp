#include "engine/geometry/path.h"

#include "engine/scene/snapshot.h"

namespace raynest {

Result<std::vector<PathStep>> expand_path(const SceneView& scene, std::uint64_t path) {
    std::vector<PathStep> steps;
    const ObjectRecord* parent = &scene.objects[scene.root];
    const ObjectRecord* const leaf = walk_path(scene, path, [&](std::uint32_t index) {
        const InstanceRecord& instance = scene.instances[index];
        const InstanceInfo& info = scene.instance_infos[index];
        const ObjectRecord& object = scene.objects[instance.object];
        PathStep& step = steps.emplace_back();
        step.instance = index - parent->first_instance;
        step.object = instance.object;
        step.uid = info.uid;
        step.name = scene.names + info.name;
        if (step.name.empty()) step.name = scene.names + object.name;
        if (step.name.empty()) step.name = '#' + std::to_string(step.instance);
        parent = &object;
    });
    if (leaf == nullptr) {
        return fail(ErrorCode::scene_invalid,
                    "the scene has no path " + std::to_string(path) + ": it has " +
                        std::to_string(scene.objects[scene.root].leaves) + ", counted from 0");
    }
    return steps;
}

std::string path_name(const std::vector<PathStep>& steps) {
    std::string name;
    for (const PathStep& step : steps) {
        if (!name.empty()) name += '/';
        name += step.name;
    }
    return name;
}

}  // namespace raynest
