// raynest admin ACT: lists and ends connections, changes quotas, reloads and drains the daemon.
#include "client/commands/deliver.h"
#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

#include <charconv>

namespace raynest::client {
namespace {

struct AdminOptions {
    std::string act;     ///< connections | drain | reload | kick | quota
    std::string target;  ///< for kick: a connection's number or a principal; for quota: a principal
    std::vector<std::string> quota;  ///< "jobs=8"
};

Result<void> list_connections(Context& context) {
    Json connections = Json::array();
    std::vector<std::vector<std::string>> rows = {
        {"CONNECTION", "PRINCIPAL", "ROLE", "TRANSPORT", "PEER", "AGE", "JOBS"}};
    const auto listed = each_connection(context.connection, [&](const ListedConnection& row) {
        connections.push_back(Json{{"connection", row.number},
                                   {"principal", row.principal},
                                   {"role", row.role},
                                   {"transport", row.transport},
                                   {"peer", row.peer},
                                   {"age_seconds", row.age_seconds},
                                   {"jobs", row.jobs}});
        rows.push_back({std::to_string(row.number), row.principal, row.role, row.transport,
                        row.peer, age_text(row.age_seconds), std::to_string(row.jobs)});
    });
    if (!listed) return listed;
    if (context.json)
        print_json(Json{{"connections", connections}});
    else
        print_table(rows);
    return {};
}

}  // namespace

void declare(CommandLine& line, AdminOptions& admin) {
    line.add_option("ACT", admin.act,
                    "connections: list them; drain: end when all jobs have ended; reload: read "
                    "certificates, tokens and configuration again; kick: end connections; quota: "
                    "show or change what a principal may have")
        .required()
        .one_of({"connections", "drain", "reload", "kick", "quota"});
    line.add_option("TARGET", admin.target,
                    "for kick: a connection's number or a principal; for quota: a principal");
    line.add_options("QUOTA", admin.quota,
                     "for quota:"
#define RAYNEST_QUOTA(key, least) " " #key "=N"
#include "protocol/lists/quotas.def"
                     "; bytes also as 20G. Without any, it shows what the principal uses");
    line.at_end([&admin]() -> std::string {
        const bool needs_target = admin.act == "kick" || admin.act == "quota";
        if (needs_target && admin.target.empty()) return "TARGET is required";
        if (!needs_target && !admin.target.empty()) return "TARGET: goes with kick and quota only";
        if (admin.act != "quota" && !admin.quota.empty())
            return "QUOTA: goes with quota, such as: admin quota alice jobs=8";
        return "";
    });
}

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
    return report_act(context, request);
}

std::unique_ptr<Command> make_admin() {
    return make_command<AdminOptions>();
}

}  // namespace raynest::client
