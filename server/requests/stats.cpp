// STATS: lists the daemon's counters and gauges by name. Administrators see the whole daemon;
// others see their own part of what principals did and hold. quota_* are the caller's own for both.
#include "server/execution/kept_selections.h"
#include "server/ground/log.h"
#include "server/jobs/scene_poser.h"
#include "server/requests/quota_use.h"
#include "server/requests/request.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/detached.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <string_view>

namespace raynest::server {
namespace {

/// The part of a gauge that one principal holds.
struct OwnPart {
    const Services& services;
    const std::string& principal;

    /// Returns the principal's part of a gauge, or `whole` of a limit or of the log.
    [[nodiscard]] std::uint64_t of(std::string_view gauge, std::uint64_t whole) const {
        const auto scenes = [&](bool listed) {
            return services.scenes.charged_to(principal, listed);
        };
        if (gauge == "connections_open") return services.peers.size_of(principal);
        if (gauge == "jobs_running") return services.admission.active_of(principal);
        if (gauge == "scenes") return scenes(true).scenes;
        if (gauge == "scenes_unlisted") return scenes(false).scenes;
        if (gauge == "scene_bytes") return scenes(true).bytes + scenes(false).bytes;
        if (gauge == "scenes_unlisted_bytes") return scenes(false).bytes;
        if (gauge == "scenes_on_disk") return services.scenes.asleep_of(principal);
        if (gauge == "memory_used_bytes") return services.scenes.memory_of(principal);
        return whole;
    }

private:
};

constexpr bool is_part(std::string_view gauge) {
    for (const std::string_view part :
         {"connections_open", "jobs_running", "scenes", "scenes_unlisted", "scene_bytes",
          "scenes_unlisted_bytes", "scenes_on_disk", "memory_used_bytes"})
        if (gauge == part) return true;
    return false;
}
/// True for gauges that are equal for everybody: limits, and the state of the log.
constexpr bool is_common(std::string_view gauge) {
    return gauge == "jobs_limit" || gauge == "memory_limit_bytes" || gauge == "log_lines_lost";
}
// A new gauge must say which it is, so that none shows others by mistake.
#define RAYNEST_GAUGE(name, ...) static_assert(is_part(#name) != is_common(#name));
#include "server/ground/metrics.def"

}  // namespace

Reply<Answer> stats(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Stats>& /*message*/) {
    wire::StatisticsT statistics;
    const auto add = [&](std::string_view name, std::uint64_t value) {
        statistics.names.emplace_back(name);
        statistics.values.push_back(static_cast<double>(value));
    };
    const bool sees_all = caller.role == Role::admin;
    const OwnPart own{services, caller.principal};
    for (std::size_t i = 0; i < metric_table.size(); ++i)
        add(metric_table[i].name, sees_all || !counts_work(metric_table[i].name)
                                      ? (services.metrics.*metric_table[i].counter).load()
                                      : services.metrics.own.of(caller.principal, i));
#define RAYNEST_GAUGE(name, value, ...) add(#name, sees_all ? (value) : own.of(#name, value));
#include "server/ground/metrics.def"
    for (const QuotaUse& use : quota_uses(services, caller.principal)) {
        add("quota_" + std::string(use.resource), use.quota);
        add("quota_" + std::string(use.resource) + "_used", use.used);
    }
    statistics.http = services.page;
    return answer_with(caller, statistics, services);
}

}  // namespace raynest::server
