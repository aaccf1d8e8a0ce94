// THE RULES of who may touch what is not only theirs: each NOT_ALLOWED that a client hears comes
// from here. They take facts; what they concern looks those up.
#pragma once

#include "server/errors.h"

#include <cstdint>
#include <string_view>

namespace raynest::server::access {

/// A job belongs to the principal that started it, on whatever connection.
[[nodiscard]] Reply<void> use_job(std::uint64_t number, std::string_view owner,
                                  std::string_view principal);

/// A scene is unloaded by those that loaded it or hold it.
[[nodiscard]] Reply<void> unload_scene(std::string_view name, std::string_view owner,
                                       bool is_callers);

/// A scene gets other content only where no other principal's load keeps its name: they would find
/// another scene.
[[nodiscard]] Reply<void> replace_scene(std::string_view name, bool is_only_callers);

}  // namespace raynest::server::access
