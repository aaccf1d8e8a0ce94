// Lights of the chosen scene, in the scene's space.
#include "engine/assets/gltf/describe.h"
#include "engine/assets/input/messages.h"
#include "engine/scene/camera_pose.h"
#include "engine/scene/snapshot.h"

#include <fmt/format.h>

namespace raynest::gltf {

void read_lights(const Model& model, MotionWriter& motion, SceneDescription& scene) {
    if (model.lights.empty()) return;
    for (const PlacedNode& entry : nodes_with(model, &Node::light)) {
        const Node& node = model.nodes[entry.node];
        const Light& light = model.lights[node.light];
        const std::string& name = node.name.empty() ? light.name : node.name;
        const auto pose = camera_pose(entry.to_scene);
        if (!light.fault.empty()) {
            leave_out(scene, "lights",
                      fmt::format("{} {} and is left out", label("light", node.light, light.name),
                                  light.fault));
            continue;
        }
        const char* const fault = !pose                                     ? no_pose
                                  : scene.lights.size() == scene_lights_max ? "is one too many"
                                                                            : nullptr;
        if (fault != nullptr) {
            leave_out(scene, "lights",
                      fmt::format("{}: its light is left out, because it {}",
                                  label("node", entry.node, name), fault));
            continue;
        }
        LightDescription description{name, light.record};
        description.light.position = place_of(*pose);
        description.light.direction = ahead_of(*pose);
        motion.place_light(static_cast<std::uint32_t>(scene.lights.size()), entry.node);
        scene.lights.push_back(std::move(description));
    }
}

}  // namespace raynest::gltf
