// raynest admin ACT: lists and ends connections, changes quotas, reloads and drains the daemon.
#include "client/commands/commands.h"
#include "client/output.h"

#include <algorithm>
#include <charconv>
#include <iostream>

namespace raynest::client {
namespace {

Result<void> list_connections(Context& context) {
    Json connections = Json::array();
    std::vector<std::vector<std::string>> rows = {
        {"CONNECTION", "PRINCIPAL", "ROLE", "TRANSPORT", "PEER", "AGE", "JOBS"}};
    wire::AdminT request;
    request.act = "connections";
    for (bool more = true; more;) {
        const auto page = ask<wire::AdminReport>(context.connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const wire::AdminReport& report = *page->message.table;
        more = report.more();
        const auto principals = protocol::strings(report.principals());
        const auto roles = protocol::strings(report.roles());
        const auto transports = protocol::strings(report.transports());
        const auto peers = protocol::strings(report.peers());
        const std::size_t count =
            std::min({principals.size(), roles.size(), transports.size(), peers.size()});
        for (std::size_t k = 0; k < count; ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            const std::uint64_t number = report.connections()->Get(i);
            const double age = static_cast<double>(report.age_ms()->Get(i)) / 1e3;
            const std::uint32_t jobs = report.jobs()->Get(i);
            connections.push_back(Json{{"connection", number},
                                       {"principal", principals[k]},
                                       {"role", roles[k]},
                                       {"transport", transports[k]},
                                       {"peer", peers[k]},
                                       {"age_seconds", age},
                                       {"jobs", jobs}});
            rows.push_back({std::to_string(number), principals[k], roles[k], transports[k],
                            peers[k], age_text(age), std::to_string(jobs)});
            request.after = number;
        }
        if (count == 0) break;
    }
    if (context.json)
        print_json(Json{{"connections", connections}});
    else
        print_table(rows);
    return {};
}

}  // namespace

Result<void> run(Context& context, const AdminOptions& options) {
    if (options.act == "connections") return list_connections(context);
    wire::AdminT request;
    request.act = options.act;
    request.quota = options.quota;
    const char* last = options.target.data() + options.target.size();
    const auto [end, error] = std::from_chars(options.target.data(), last, request.connection);
    if (options.act != "kick" || error != std::errc{} || end != last) {
        request.connection = 0;
        request.principal = options.target;
    }
    const auto report = ask<wire::AdminReport>(context.connection, request);
    if (!report) return tl::unexpected<Failure>(report.error());
    const std::string text(protocol::text((*report)->text()));
    if (context.json)
        print_json(Json{{"text", text}});
    else
        std::cout << text << '\n';
    return {};
}

}  // namespace raynest::client
