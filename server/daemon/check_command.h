// raynestd check DIR: looks at a state folder while no daemon uses it.
#pragma once

#include <filesystem>

namespace raynest::server {

/// Reads the manifest and every blob, changes nothing, and prints a line for each scene that cannot be
/// used. Returns the exit code: 0 if all scenes are whole, else 1.
[[nodiscard]] int check_state(const std::filesystem::path& folder);

}  // namespace raynest::server
