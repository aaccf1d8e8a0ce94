// The values of --socket-mode and --socket-group.
#pragma once

#include <optional>
#include <string>

namespace raynest::server {

/// Parses an octal mode; nothing if it is invalid or the owner could not read and write.
[[nodiscard]] std::optional<unsigned> to_mode(const std::string& text);
/// Returns the error text for a mode; empty if there is no error.
[[nodiscard]] std::string mode_fault(const std::string& text);

/// Returns the id of a group given by name or number; nothing if there is none.
[[nodiscard]] std::optional<unsigned> to_group(const std::string& text);
/// Returns the error text for a group; empty if there is no error.
[[nodiscard]] std::string group_fault(const std::string& text);

}  // namespace raynest::server
