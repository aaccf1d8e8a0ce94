// The daemon's values in the text format of Prometheus, for /metrics.
#pragma once

#include "server/requests/request.h"

#include <optional>
#include <string>

namespace raynest::server {

/// Returns the values of metrics.def, the build, durations of jobs, and process_*; with TLS the
/// days that the certificate is still valid. Rows about principals tell an administrator of the
/// fifty that did something last, and others of themselves. Io thread only.
[[nodiscard]] std::string exposition(const Services& services, const Principal& reader,
                                     std::optional<double> certificate_days_left = {});

}  // namespace raynest::server
