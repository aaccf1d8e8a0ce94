// raynestd check DIR looks at a state folder while no daemon uses it; raynestd backup DIR NEW
// copies one while a daemon may use it; raynestd restore BACKUP DIR copies it back; raynestd gc DIR
// makes room.
#pragma once

#include <filesystem>

namespace raynest::server {

/// Reads the manifest and every blob, changes nothing, and prints a line for each scene that cannot
/// be used. Returns the exit code: 0 if all scenes are whole, else 1.
[[nodiscard]] int check_state(const std::filesystem::path& folder);

/// Makes a copy, checks that as above, and prints what it holds. Returns the exit code: 0 if all
/// scenes of the copy are whole, else 1.
[[nodiscard]] int back_up_state(const std::filesystem::path& from, const std::filesystem::path& to);

/// Makes the state folder `to`, which must be new or empty and used by nobody, out of a backup,
/// checks it as above, and prints what it holds. Nothing is there if the copy fails. Returns the
/// exit code as back_up_state() does.
[[nodiscard]] int restore_state(const std::filesystem::path& backup,
                                const std::filesystem::path& to);

/// Removes unfinished files and the blobs that no row names, and prints how many bytes that frees.
/// Returns the exit code.
[[nodiscard]] int collect_state(const std::filesystem::path& folder);

}  // namespace raynest::server
