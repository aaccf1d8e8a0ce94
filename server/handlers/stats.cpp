// STATS: lists the daemon's counters and gauges by name.
#include "server/handlers/handler.h"
#include "server/jobs/admission.h"
#include "server/jobs/peers.h"

namespace raynest::server {

Reply<Answer> stats(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Stats>& /*message*/) {
    wire::StatisticsT statistics;
    const auto add = [&](std::string_view name, std::uint64_t value) {
        statistics.names.emplace_back(name);
        statistics.values.push_back(static_cast<double>(value));
    };
    for (const MetricInfo& metric : metric_table)
        add(metric.name, services.metrics.*metric.counter);
#define RAYNEST_GAUGE(name, value, ...) add(#name, value);
#include "server/diag/metrics.def"
    statistics.http = services.page;
    return answer_with(caller, statistics, services);
}

}  // namespace raynest::server
