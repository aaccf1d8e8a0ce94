// Translates the protocol's words in messages to those of the command line.
#pragma once

#include <string>
#include <string_view>

namespace raynest::client {

/// Replaces the words between backticks in a message of the daemon, which are fields or messages of
/// the protocol (PROTOCOL.md, 9), by the command line's: `deadline_ms` becomes --deadline, `Scenes`
/// becomes raynest scenes. Other words stay.
[[nodiscard]] std::string localize_message(std::string_view message);

}  // namespace raynest::client
