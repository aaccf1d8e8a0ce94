// STATS: lists the daemon's counters and gauges by name.
#include "server/handlers/handler.h"
#include "server/jobs/admission.h"
#include "server/jobs/peers.h"

#include <string_view>

namespace raynest::server {
namespace {

/// True for gauges that would tell a client whether another has loaded the same scene.
constexpr bool tells_of_scenes(std::string_view gauge) {
    return gauge.starts_with("scene") || gauge == "memory_used_bytes";
}

}  // namespace

Reply<Answer> stats(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Stats>& /*message*/) {
    wire::StatisticsT statistics;
    const auto add = [&](std::string_view name, std::uint64_t value) {
        statistics.names.emplace_back(name);
        statistics.values.push_back(static_cast<double>(value));
    };
    for (const MetricInfo& metric : metric_table)
        add(metric.name, services.metrics.*metric.counter);
    const bool sees_scenes = caller.shares_machine || caller.role == Role::admin;
#define RAYNEST_GAUGE(name, value, ...) \
    if (sees_scenes || !tells_of_scenes(#name)) add(#name, value);
#include "server/diag/metrics.def"
    statistics.http = services.page;
    return answer_with(caller, statistics, services);
}

}  // namespace raynest::server
