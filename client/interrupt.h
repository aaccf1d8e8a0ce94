// Ctrl-C: noted, so that the running request can be cancelled before the process ends.
#pragma once

namespace raynest::client {

/// From now on the first SIGINT or SIGTERM is only noted; a second one ends the process.
void catch_interrupts();
[[nodiscard]] bool interrupted();

}  // namespace raynest::client
