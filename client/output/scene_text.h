// Prints SceneInfo for `load` and `info`; scripts rely on the JSON keys.
#pragma once

#include "client/ground/json.h"
#include "protocol/control.h"

namespace raynest::client {

[[nodiscard]] Json scene_json(const wire::SceneInfo& info);
/// `epo` is the EPO of the scene's trees, or null: not measured.
void print_scene(const wire::SceneInfo& info, const Json& epo = nullptr);

}  // namespace raynest::client
