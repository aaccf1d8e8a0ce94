// Notes Ctrl-C and the end of the terminal, so that the running request can be cancelled before the
// process ends.
#pragma once

namespace raynest::client {

/// Makes the first SIGINT, SIGTERM or SIGHUP a note only; a second one ends the process.
void catch_interrupts();
[[nodiscard]] bool interrupted();

}  // namespace raynest::client
