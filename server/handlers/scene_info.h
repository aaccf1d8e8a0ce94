// What a scene tells about itself, fitted into a control message.
#pragma once

#include "protocol/control.h"
#include "protocol/text.h"
#include "server/store/scene_store.h"

namespace raynest::server {

using protocol::clean_text;

/// Never larger than a message: of long lists the beginning, and a warning with the rest's count.
[[nodiscard]] wire::SceneInfoT scene_info(const NamedScene& scene, const protocol::Limits& limits);

}  // namespace raynest::server
