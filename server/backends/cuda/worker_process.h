// The device worker: a process of its own that has the device, so that an error of a kernel, which
// poisons all that its process has there, ends this process and not the daemon.
#pragma once

#include <string_view>

namespace raynest::server::device {

/// `raynestd --device-worker PACK` is this process.
inline constexpr std::string_view worker_flag = "--device-worker";

/// Serves the daemon at descriptor 3 until it closes; `pack` is a kernel pack with the door of
/// packs/device.h. Gives the process's exit code.
int run_worker_process(const char* pack);

}  // namespace raynest::server::device
