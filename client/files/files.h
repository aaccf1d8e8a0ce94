// Reads files: those that the user names, and those that a scene names below its folder.
#pragma once

#include "client/ground/failure.h"
#include "protocol/buffer.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>

namespace raynest::client {

/// Maximum bytes read from a pipe or a device, whose size is unknown.
inline constexpr std::uint64_t piped_bytes_max = 4ULL << 30;

/// The name of stdin and stdout where a file is expected.
inline constexpr const char* standard_stream = "-";

/// Returns a path as messages name it: "-" is stdin.
[[nodiscard]] std::string shown_name(const std::string& path);

/// Returns the ending of a file's name in small letters with its dot, ".png", or "".
[[nodiscard]] std::string extension_of(const std::string& path);
/// True for a device or a pipe, such as /dev/null, which takes any format.
[[nodiscard]] bool is_device(const std::string& path);

/// Checks the bytes of a pipe that have come: nothing where it takes more to judge, else how many
/// the pipe may have at most. A failure ends the reading at once.
using CheckBegin = std::function<Result<std::optional<std::uint64_t>>(std::span<const std::byte>)>;

/// Reads the file, pipe or device that the user named; "-" and /dev/stdin are stdin. A pipe is read
/// to its end; it may have piped_bytes_max, and Ctrl-C ends the wait with exit code 130. Other
/// errors give exit code 5 and name the file.
Result<protocol::Buffer> read_file(const std::string& path, std::uint64_t bytes_max,
                                   const CheckBegin& check = {});

/// The same for `name` beneath `folder`; nothing where there is no such file. Symbolic links are
/// followed where they end in the folder, so that a scene from a stranger cannot have other files
/// uploaded. What is opened lies beneath the folder, whatever is renamed meanwhile.
Result<std::optional<protocol::Buffer>> read_file_beneath(const std::string& folder,
                                                          const std::string& name,
                                                          std::uint64_t bytes_max);

}  // namespace raynest::client
