// Counters of the daemon, as metrics.def lists them.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string_view>

namespace raynest::server {

/// Thread-safe; counters only grow.
struct Metrics {
    using Counter = std::atomic<std::uint64_t>;
#define RAYNEST_METRIC(name, text) Counter name{0};
#include "server/diag/metrics.def"
};

struct MetricInfo {
    std::string_view name;
    Metrics::Counter Metrics::*counter;
};

inline constexpr std::array metric_table = {
#define RAYNEST_METRIC(name, text) MetricInfo{#name, &Metrics::name},
#include "server/diag/metrics.def"
};

}  // namespace raynest::server
