// The daemon: owns the packs, the scenes, the workers, the listeners and the connections, and knows
// the order in which they start and stop.
#pragma once

#include "server/options.h"

#include <string_view>

namespace raynest::server {

/// `raynestd --import-child TARGET [PACK_DIR...]` is the import process of engine/assets/import.h.
inline constexpr std::string_view import_child_flag = "--import-child";

/// Runs until SIGTERM or SIGINT; returns the exit code: 0 after a drain, 1 with a line on stderr
/// when packs, addresses or the state folder cannot be had. A second one of these signals, or a
/// drain of over drain_ms_max, ends the process with code 3. SIGHUP is logged and ignored.
int run_daemon(const Options& options);

}  // namespace raynest::server
