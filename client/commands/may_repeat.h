// Which commands may run once more after their daemon went away.
#pragma once

#include "client/commands/commands.h"

namespace raynest::client {

/// True if the command does the same when it runs again after `why`: it changes nothing, or what it
/// loads can be read once more. `printed`: a part of its answer is on stdout.
[[nodiscard]] bool may_repeat(const CommandOptions& command, const Failure& why, bool printed);

}  // namespace raynest::client
