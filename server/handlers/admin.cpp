// ADMIN: lists and ends connections, changes quotas, reloads and drains the daemon.
#include "server/administration.h"
#include "server/handlers/handler.h"
#include "server/log.h"
#include "server/security/tokens.h"

#include <utility>

namespace raynest::server {
namespace {

constexpr std::size_t page_connections = 100;

void list_connections(const Administration& daemon, std::uint64_t after,
                      wire::AdminReportT& report) {
    for (ConnectionRow& row : daemon.connections(after)) {
        report.more = report.connections.size() == page_connections;
        if (report.more) return;
        report.connections.push_back(row.number);
        report.principals.push_back(std::move(row.principal));
        report.roles.push_back(std::move(row.role));
        report.transports.push_back(std::move(row.transport));
        report.peers.push_back(std::move(row.peer));
        report.age_ms.push_back(row.age_ms);
        report.jobs.push_back(row.jobs);
    }
}

Reply<void> set_quota(Administration& daemon, const wire::Admin& message,
                      wire::AdminReportT& report) {
    std::string text;
    for (const std::string& part : protocol::strings(message.quota()))
        text += (text.empty() ? "" : ",") + part;
    const auto quota = parse_quota(text);
    const std::string principal(protocol::text(message.principal()));
    if (!quota || text.empty())
        return refuse(Code::invalid_field, "'" + text +
                                               "' is not a quota; write jobs=N, rays=N, "
                                               "scene_bytes=N, second_bytes=N or "
                                               "connections=N");
    if (principal.empty())
        return refuse(Code::invalid_field, "the quota needs a principal");
    daemon.set_quota(principal, *quota);
    report.text = principal + " has " + to_text(*quota) + " until the daemon ends";
    return {};
}

}  // namespace

Reply<Answer> admin(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Admin>& message) {
    if (services.administration == nullptr)
        return refuse(Code::unsupported, "this daemon has no administration");
    Administration& daemon = *services.administration;
    const std::string act(protocol::text(message->act()));
    const std::string principal(protocol::text(message->principal()));
    log(LogLevel::info, "admin",
        {{"principal", caller.principal}, {"act", act}, {"on", principal}});
    wire::AdminReportT report;
    if (act == "connections") {
        list_connections(daemon, message->after(), report);
    } else if (act == "kick") {
        if (message->connection() == 0 && principal.empty())
            return refuse(Code::invalid_field, "name a connection or a principal");
        const std::size_t count = daemon.kick(message->connection(), principal);
        report.text = std::to_string(count) + " connections ended";
    } else if (act == "quota") {
        if (const auto set = set_quota(daemon, *message.table, report); !set)
            return tl::unexpected(set.error());
    } else if (act == "reload") {
        report.text = daemon.reload();
    } else if (act == "drain") {
        daemon.drain();
        report.text = "the daemon takes no more work and ends when its jobs have ended";
    } else {
        return refuse(Code::invalid_field, "unknown act '" + act +
                                               "': use one of connections, drain, reload, kick, "
                                               "quota");
    }
    return answer_with(caller, report, services);
}

}  // namespace raynest::server
