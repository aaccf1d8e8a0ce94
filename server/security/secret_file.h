// Files of an administrator: read within limits, and replaced as a whole. Those that hold secrets
// may be read by their owner alone, or by a group to which root gave them.
#pragma once

#include "engine/result.h"
#include "server/security/file_place.h"

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

namespace raynest::server {

/// The program that reads a secret. The daemon trusts files of its own user and of root alone. A
/// command that root runs may edit those of the daemon's user. A signer reads the key of a CA,
/// which nobody but its own user and root may own or read.
enum class Reader { daemon, command, signer };

/// Reads a whole file of at most `bytes_max` bytes. Refuses a pipe, a device and a folder before it
/// reads; never waits. Fails if others could change it (file_place.h). The message names the file and the
/// remedy.
[[nodiscard]] Result<std::string> read_regular_file(const std::filesystem::path& file,
                                                    std::size_t bytes_max, const std::string& harm);

/// As read_regular_file(). Fails too if the file belongs to a user whom the reader does not trust,
/// or if other users can read or write it; the daemon asks too who else could put another in its place.
/// A file of root with mode 0640 is good if its group is
/// root's or one of this process, but not one that everybody is in; or, for a command of root, any
/// such group.
[[nodiscard]] Result<std::string> read_secret_file(const std::filesystem::path& file,
                                                   std::size_t bytes_max, Reader reader);

/// The same for a file whose place was found. A symbolic link that has taken its place is not
/// followed.
[[nodiscard]] Result<std::string> read_regular_file(const FilePlace& place, std::size_t bytes_max);
[[nodiscard]] Result<std::string> read_secret_file(const FilePlace& place, std::size_t bytes_max,
                                                   Reader reader);

/// A file and its new content.
struct NewFile {
    FilePlace place;
    std::string content;
    /// True: fails if a file is there. False: replaces it.
    bool is_first = false;
};

/// Writes files under temporary names in their folders, syncs them, and moves them into place once
/// all are written: readers find the old content or the new one, and a full disk changes nothing. A
/// file that existed keeps its owner, group and mode; a new one gets mode 0600.
[[nodiscard]] Result<void> write_files_atomically(const std::vector<NewFile>& files);

}  // namespace raynest::server
