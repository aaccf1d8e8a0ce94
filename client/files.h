// Opening files that somebody else's file names: beneath a folder, regular files only.
#pragma once

#include "client/failure.h"
#include "protocol/buffer.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

namespace raynest::client {

/// The bytes of the file at `path`, which the user named. Devices, pipes and folders are refused
/// without being waited for. Exit code 5, naming the file.
Result<protocol::Buffer> read_file(const std::string& path, std::uint64_t bytes_max);

/// The same for `name` beneath `folder`; nothing where there is no such file. Symbolic links are
/// followed as long as they stay in the folder, so that a scene from a stranger cannot have other
/// files uploaded; the kernel sees to that (openat2).
Result<std::optional<protocol::Buffer>> read_file_beneath(const std::string& folder,
                                                          const std::string& name,
                                                          std::uint64_t bytes_max);

/// Whether write_file has a chance: asked before work of minutes, whose result would be lost.
Result<void> check_writable(const std::string& path);
/// Writes a whole file, or leaves none behind: a new file takes the place of the old one at the
/// end. Of a link the end is written; what is no regular file is written to.
Result<void> write_file(const std::string& path, std::span<const std::byte> bytes);

}  // namespace raynest::client
