// The daemon's counters, as listed in metrics.def.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string_view>

namespace raynest::server {

/// The counters; they only grow. Thread-safe.
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
