// The daemon: owns packs, scenes, workers, listeners and connections; starts and stops them.
#pragma once

#include "engine/result.h"
#include "server/options/options.h"

#include <functional>

namespace raynest::server {

/// Reads the options once more; an error says which line of which file is wrong.
using ReadOptions = std::function<Result<Options>()>;

/// Runs until SIGTERM or SIGINT. Returns the exit code: 0 after a drain; 1 with a line on stderr if
/// packs, an address or the state folder cannot be used. A second signal, or a drain longer than
/// drain_ms_max, ends the process with code 3. SIGHUP calls `read_again`, which returns the options
/// of the same command line and configuration file as they are now, and applies what may change
/// while the daemon runs; then it reads certificates and tokens again.
int run_daemon(Options options, ReadOptions read_again = {});

}  // namespace raynest::server
