// The device worker process. It alone uses the device: a kernel error invalidates all device state
// of its process, so it costs this process and not the daemon.
#pragma once

#include <string_view>

namespace raynest::server::device {

/// The command line of the process is `raynestd --device-worker PACK`.
inline constexpr std::string_view worker_flag = "--device-worker";

/// Serves the daemon on descriptor 3 until the daemon closes it. `pack` is the path of a kernel
/// pack with the interface of packs/device.h. Returns the exit code of the process.
int run_worker_process(const char* pack);

}  // namespace raynest::server::device
