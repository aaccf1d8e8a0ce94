// The daemon: owns packs, scenes, workers, listeners and connections; starts and stops them.
#pragma once

#include "server/options.h"

#include <string_view>

namespace raynest::server {

/// The command line of the import process (engine/assets/import.h) is
/// `raynestd --import-child TARGET [PACK_DIR...]`.
inline constexpr std::string_view import_child_flag = "--import-child";

/// Runs until SIGTERM or SIGINT. Returns the exit code: 0 after a drain; 1 with a line on stderr if
/// packs, an address or the state folder cannot be used. A second signal, or a drain longer than
/// drain_ms_max, ends the process with code 3. SIGHUP reads
/// certificates and tokens again.
int run_daemon(const Options& options);

}  // namespace raynest::server
