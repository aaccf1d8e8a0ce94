// The daemon's values in the text format of Prometheus, for /metrics.
#pragma once

#include "server/handlers/handler.h"

#include <string>

namespace raynest::server {

/// Media type of the text.
inline constexpr const char* exposition_type = "text/plain; version=0.0.4; charset=utf-8";

/// Returns the values of metrics.def, the build, durations of jobs, and process_*. Io thread only.
[[nodiscard]] std::string exposition(const Services& services);

}  // namespace raynest::server
