// Which counter a refused request belongs to.
#pragma once

#include "protocol/errors.h"
#include "server/ground/metrics.h"

namespace raynest::server {

[[nodiscard]] Metrics::Counter& refusals_of(Metrics& metrics, protocol::Code code);

}  // namespace raynest::server
