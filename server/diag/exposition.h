// The daemon's values in the text format of Prometheus, for /metrics.
#pragma once

#include "server/handlers/handler.h"

#include <string>

namespace raynest::server {

/// Returns the values of metrics.def, the build, durations of jobs, and process_*. Io thread only.
[[nodiscard]] std::string exposition(const Services& services);

}  // namespace raynest::server
