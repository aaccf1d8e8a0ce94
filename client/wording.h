// The daemon's words in those of the command line.
#pragma once

#include <string>
#include <string_view>

namespace raynest::client {

/// A message of the daemon, in which each word between backticks is a field or a message of the
/// protocol (PROTOCOL.md, 9), with the command line's spelling in its place: `deadline_ms` becomes
/// --deadline, `Scenes` becomes raynest scenes. Other words stay as they are.
[[nodiscard]] std::string in_own_words(std::string_view message);

}  // namespace raynest::client
