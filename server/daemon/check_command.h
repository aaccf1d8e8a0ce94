// raynestd check DIR looks at a state folder while no daemon uses it; raynestd backup DIR NEW
// copies one while a daemon may use it.
#pragma once

#include <filesystem>

namespace raynest::server {

/// Reads the manifest and every blob, changes nothing, and prints a line for each scene that cannot
/// be used. Returns the exit code: 0 if all scenes are whole, else 1.
[[nodiscard]] int check_state(const std::filesystem::path& folder);

/// Makes a copy, checks that as above, and prints what it holds. Returns the exit code: 0 if all
/// scenes of the copy are whole, else 1.
[[nodiscard]] int back_up_state(const std::filesystem::path& from, const std::filesystem::path& to);

}  // namespace raynest::server
