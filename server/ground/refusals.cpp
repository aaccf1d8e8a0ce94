#include "server/ground/refusals.h"

namespace raynest::server {

Metrics::Counter& refusals_of(Metrics& metrics, protocol::Code code) {
    using protocol::Code;
    switch (code) {
        case Code::busy:
            return metrics.refused_busy;
        case Code::quota:
            return metrics.refused_quota;
        case Code::resource_exhausted:
            return metrics.refused_memory;
        case Code::limit_exceeded:
            return metrics.refused_limit;
        case Code::draining:
            return metrics.refused_draining;
        case Code::not_allowed:
            return metrics.refused_not_allowed;
        default:
            return metrics.refused_invalid;
    }
}

}  // namespace raynest::server
