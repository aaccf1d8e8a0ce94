// Files of an administrator: read within limits, and replaced as a whole. Those that hold secrets may
// be read by their owner alone.
#pragma once

#include "engine/result.h"

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

namespace raynest::server {

/// The program that reads a secret. The daemon trusts files of its own user and of root alone. A
/// command that root runs may edit those of the daemon's user.
enum class Reader { daemon, command };

/// Reads a whole file of at most `bytes_max` bytes. Refuses a pipe, a device and a folder before it
/// reads; never waits. The message names the file and the remedy.
[[nodiscard]] Result<std::string> read_regular_file(const std::filesystem::path& file,
                                                    std::size_t bytes_max);

/// As read_regular_file(). Fails too if the file belongs to a user whom the reader does not trust,
/// or if other users can read or write it.
[[nodiscard]] Result<std::string> read_secret_file(const std::filesystem::path& file,
                                                   std::size_t bytes_max, Reader reader);

/// Returns the file that a path means, behind its symbolic links. Fails if the last one leads
/// nowhere, or if it belongs to a user who owns neither this process nor the target: such a link
/// could lead root to any file.
[[nodiscard]] Result<std::filesystem::path> behind_links(const std::filesystem::path& file);

/// A file and its new content.
struct NewFile {
    std::filesystem::path path;
    std::string content;
};

/// Writes files under temporary names in their folders, syncs them, and moves them into place once all
/// are written: readers find the old content or the new one, and a full disk changes nothing. A file
/// that existed keeps its owner, group and mode; a new one gets mode 0600.
[[nodiscard]] Result<void> write_files_atomically(const std::vector<NewFile>& files);

}  // namespace raynest::server
