// Files that hold secrets: only their owner may read them.
#pragma once

#include "engine/result.h"

#include <filesystem>
#include <string>
#include <string_view>

namespace raynest::server {

/// Fails unless the file is a regular file that belongs to the daemon's user or root, and that no
/// other user can read or write. The message names the file and the remedy.
[[nodiscard]] Result<void> check_secret_file(const std::filesystem::path& file);

/// Reads a whole secret file of at most `bytes_max` bytes, after check_secret_file().
[[nodiscard]] Result<std::string> read_secret_file(const std::filesystem::path& file,
                                                   std::size_t bytes_max);

/// Writes a file with mode `mode` under a temporary name in its folder, syncs it, and moves it into
/// place: readers find the old content or the new one.
[[nodiscard]] Result<void> write_file_atomically(const std::filesystem::path& file,
                                                 std::string_view content, unsigned mode = 0600);

}  // namespace raynest::server
