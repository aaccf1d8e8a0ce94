// Notes Ctrl-C, so that the running request can be cancelled before the process ends.
#pragma once

namespace raynest::client {

/// Makes the first SIGINT or SIGTERM a note only; a second one ends the process.
void catch_interrupts();
[[nodiscard]] bool interrupted();

}  // namespace raynest::client
