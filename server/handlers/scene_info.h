// What a scene tells about itself, fitted into a control message.
#pragma once

#include "protocol/control.h"
#include "server/store/scene_store.h"

#include <memory>
#include <string>
#include <string_view>

namespace raynest::server {

/// Text that came out of a file, made safe to send: what is not printable UTF-8 becomes '?', and it
/// ends after `bytes_max` bytes.
[[nodiscard]] std::string clean_text(std::string_view text, std::size_t bytes_max);

/// Never larger than a message: of long lists the beginning, and a warning with the rest's count.
[[nodiscard]] wire::SceneInfoT scene_info(const NamedScene& scene, const protocol::Limits& limits);

}  // namespace raynest::server
