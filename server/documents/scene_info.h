// The description of a scene, fitted into a control message.
#pragma once

#include "engine/packs/registry.h"
#include "protocol/control.h"
#include "server/store/named_scene.h"

namespace raynest::server {

/// Describes a scene. Long lists are cut to fit a message; a warning counts the missing items.
[[nodiscard]] wire::SceneInfoT scene_info(const NamedScene& scene, const Registry& registry,
                                          const protocol::Limits& limits);

}  // namespace raynest::server
