// The daemon's counters, as listed in metrics.def.
#pragma once

#include "server/ground/own_counts.h"
#include "server/ground/ray_counts.h"

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace raynest::server {

/// Durations by upper bounds; thread-safe.
class DurationHistogram {
public:
    static constexpr std::array<double, 8> bounds_s = {0.001, 0.01, 0.05, 0.25, 1, 5, 30, 120};

    void add(double seconds) {
        std::size_t bin = 0;
        while (bin < bounds_s.size() && seconds > bounds_s[bin]) ++bin;
        ++counts_[bin];
        sum_us_ += static_cast<std::uint64_t>(seconds * 1e6);
    }
    /// Number of durations in a bin; the last bin is above all bounds.
    [[nodiscard]] std::uint64_t count(std::size_t bin) const { return counts_[bin]; }
    [[nodiscard]] double sum_s() const { return static_cast<double>(sum_us_.load()) * 1e-6; }

private:
    std::array<std::atomic<std::uint64_t>, bounds_s.size() + 1> counts_{};
    std::atomic<std::uint64_t> sum_us_{0};
};

/// The counters; they only grow. Thread-safe.
struct Metrics {
    using Counter = std::atomic<std::uint64_t>;
#define RAYNEST_METRIC(name, ...) Counter name{0};
#define RAYNEST_SPLIT(name, ...) Counter name{0};
#include "server/ground/metrics.def"
    DurationHistogram job_seconds;     ///< from a job's start to its end
    DurationHistogram cancel_seconds;  ///< from a job's cancellation to the end of its last task
    DurationHistogram load_seconds;    ///< from the request for a scene to its publication
    RayCounts rays_by_label;           ///< `rays`, split
    OwnCounts own;                     ///< the counters of counts_work(), for each principal

    /// Adds to such a counter, the daemon's and the principal's.
    template <Counter Metrics::*counter>
    void count(const std::string& principal, std::uint64_t more = 1);
};

struct MetricInfo {
    std::string_view name;
    Metrics::Counter Metrics::*counter;
};

inline constexpr std::array metric_table = {
#define RAYNEST_METRIC(name, ...) MetricInfo{#name, &Metrics::name},
#define RAYNEST_SPLIT(name, ...) MetricInfo{#name, &Metrics::name},
#include "server/ground/metrics.def"
};
static_assert(metric_table.size() <= OwnCounts::counters_max);

/// True for a counter that tells what principals did: each is told its own part. The others tell
/// how often the daemon refused or ended something, whoever it was.
[[nodiscard]] constexpr bool counts_work(std::string_view counter) {
    for (const std::string_view begin : {"jobs_", "scenes_", "selections_", "frames_", "bytes_"})
        if (counter.starts_with(begin)) return true;
    return counter == "rays";
}

/// Returns the position of a counter in metric_table.
[[nodiscard]] constexpr std::size_t position_of(Metrics::Counter Metrics::*counter) {
    std::size_t position = 0;
    while (metric_table[position].counter != counter) ++position;
    return position;
}

template <Metrics::Counter Metrics::*counter>
void Metrics::count(const std::string& principal, std::uint64_t more) {
    constexpr std::size_t position = position_of(counter);
    static_assert(counts_work(metric_table[position].name));
    this->*counter += more;
    own.add(principal, position, more);
}

}  // namespace raynest::server
