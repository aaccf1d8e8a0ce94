// Counters of the daemon, one line each: what `raynest stats` prints.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string_view>

namespace raynest::server {

/// Thread-safe; only ever added to. Whatever is "now" follows from two of them.
struct Metrics {
    using Counter = std::atomic<std::uint64_t>;
    Counter connections_accepted{0};
    Counter connections_closed{0};
    Counter connections_refused{0};
    Counter frames_received{0};
    Counter frames_sent{0};
    Counter bytes_received{0};
    Counter bytes_sent{0};
    Counter bad_frames{0};
    Counter timeouts{0};
    Counter gave_way_connections{0};
    Counter gave_way_jobs{0};
    Counter gave_way_memory{0};
    Counter jobs_started{0};
    Counter jobs_ended{0};
    Counter jobs_cancelled{0};
    Counter jobs_failed{0};
    Counter jobs_refused{0};
    Counter tasks_coalesced{0};
    Counter cuda_starts{0};
    Counter cuda_faults{0};
    Counter cuda_calls{0};
    Counter cuda_refusals{0};
    Counter rays{0};
    Counter scenes_loaded{0};
};

struct MetricInfo {
    std::string_view name;
    Metrics::Counter Metrics::*counter;
};

inline constexpr std::array metric_table = {
    MetricInfo{"connections_accepted", &Metrics::connections_accepted},
    MetricInfo{"connections_closed", &Metrics::connections_closed},
    MetricInfo{"connections_refused", &Metrics::connections_refused},
    MetricInfo{"frames_received", &Metrics::frames_received},
    MetricInfo{"frames_sent", &Metrics::frames_sent},
    MetricInfo{"bytes_received", &Metrics::bytes_received},
    MetricInfo{"bytes_sent", &Metrics::bytes_sent},
    MetricInfo{"bad_frames", &Metrics::bad_frames},
    MetricInfo{"timeouts", &Metrics::timeouts},
    MetricInfo{"gave_way_connections", &Metrics::gave_way_connections},
    MetricInfo{"gave_way_jobs", &Metrics::gave_way_jobs},
    MetricInfo{"gave_way_memory", &Metrics::gave_way_memory},
    MetricInfo{"jobs_started", &Metrics::jobs_started},
    MetricInfo{"jobs_ended", &Metrics::jobs_ended},
    MetricInfo{"jobs_cancelled", &Metrics::jobs_cancelled},
    MetricInfo{"jobs_failed", &Metrics::jobs_failed},
    MetricInfo{"jobs_refused", &Metrics::jobs_refused},
    MetricInfo{"tasks_coalesced", &Metrics::tasks_coalesced},
    MetricInfo{"cuda_starts", &Metrics::cuda_starts},
    MetricInfo{"cuda_faults", &Metrics::cuda_faults},
    MetricInfo{"cuda_calls", &Metrics::cuda_calls},
    MetricInfo{"cuda_refusals", &Metrics::cuda_refusals},
    MetricInfo{"rays", &Metrics::rays},
    MetricInfo{"scenes_loaded", &Metrics::scenes_loaded},
};
static_assert(sizeof(Metrics) == metric_table.size() * sizeof(Metrics::Counter),
              "a counter is missing from the table");

}  // namespace raynest::server
