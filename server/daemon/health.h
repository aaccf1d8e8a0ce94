// Why a daemon that lives takes no work, for /readyz.
#pragma once

#include "protocol/limits.h"

#include <string>

namespace raynest::server {

class FairThreadPool;
class StartLoads;

/// Returns the reason: scenes are being loaded, file descriptors are short, or a thread of
/// `compute` is stuck. Empty if there is none. Io thread only.
[[nodiscard]] std::string unready_reason(const StartLoads& loads, FairThreadPool& compute,
                                         const protocol::Limits& limits);

}  // namespace raynest::server
