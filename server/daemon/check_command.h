// The care of a state folder: raynestd check, restore and gc while no daemon uses it, raynestd backup
// while one may.
#pragma once

#include <filesystem>

namespace raynest::server {

/// How a command writes: lines to read, or one JSON document, and an error as one on stderr.
enum class Form { text, json };

/// Reads the manifest and every blob, changes nothing, and prints a line for each scene that cannot
/// be used. Returns the exit code: 0 if all scenes are whole, else 1.
[[nodiscard]] int check_state(const std::filesystem::path& folder, Form form);

/// Makes a copy, checks that as above, and prints what it holds. Returns the exit code: 0 if all
/// scenes of the copy are whole, else 1.
[[nodiscard]] int back_up_state(const std::filesystem::path& from, const std::filesystem::path& to,
                                Form form);

/// Puts a backup in the place of what the folder holds, checks that as above, and prints what it
/// holds. Returns the exit code likewise.
[[nodiscard]] int restore_state(const std::filesystem::path& backup,
                                const std::filesystem::path& folder, Form form);

/// Removes what no scene needs, and prints how much that was. Returns the exit code: 0, or 1 if it
/// cannot.
[[nodiscard]] int remove_state_garbage(const std::filesystem::path& folder, Form form);

}  // namespace raynest::server
