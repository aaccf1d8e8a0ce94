// Access rules: every NOT_ALLOWED error that a client receives comes from these functions. They
// decide by their arguments alone; callers look the facts up.
#pragma once

#include "server/errors.h"

#include <cstdint>
#include <string_view>

namespace raynest::server::access {

/// Allows the principal that started the job, on any connection.
[[nodiscard]] Reply<void> use_job(std::uint64_t number, std::string_view owner,
                                  std::string_view principal);

/// Allows callers that loaded the scene or hold it.
[[nodiscard]] Reply<void> unload_scene(std::string_view name, std::string_view owner,
                                       bool is_callers);

/// Allows a replacement only if no other principal has loaded the scene by this name: others would
/// find different content under it.
[[nodiscard]] Reply<void> replace_scene(std::string_view name, bool is_only_callers);

}  // namespace raynest::server::access
