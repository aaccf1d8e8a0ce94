// systemd's journal takes the priority of a line on stderr from a prefix such as "<4>".
#pragma once

#include "server/ground/log.h"

#include <string_view>

namespace raynest::server {

/// Returns the prefix of lines of this level, such as "<3>" for errors; empty where stderr is not
/// the journal. Ends with a null character. Thread-safe.
[[nodiscard]] std::string_view journal_priority(LogLevel level);

}  // namespace raynest::server
