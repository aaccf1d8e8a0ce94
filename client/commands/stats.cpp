// raynest stats: the daemon's counters.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/output/output.h"

#include <cmath>

namespace raynest::client {
namespace {

struct StatsOptions {};

/// Returns a whole number as an integer, any other as it is.
Json number(double value) {
    const bool whole = std::floor(value) == value && std::abs(value) < 9.0e15;
    return whole ? Json(static_cast<std::int64_t>(value)) : Json(value);
}

}  // namespace

void declare(CommandLine&, StatsOptions&) {}

Result<void> run(Context& context, const StatsOptions&) {
    const auto reply = ask<wire::Statistics>(context.connection, wire::StatsT{});
    if (!reply) return tl::unexpected<Failure>(reply.error());
    Json json = Json::object();
    std::vector<std::vector<std::string>> rows = {{"COUNTER", "VALUE"}};
    const std::vector<std::string> names = protocol::strings((*reply)->names());
    for (std::size_t i = 0; i < names.size(); ++i) {
        const double value = (*reply)->values()->Get(static_cast<flatbuffers::uoffset_t>(i));
        json[names[i]] = number(value);
        rows.push_back({names[i], number(value).dump()});
    }
    if (context.json)
        print_json(json);
    else
        print_table(rows);
    return {};
}

std::unique_ptr<Command> make_stats() {
    return make_command<StatsOptions>();
}

}  // namespace raynest::client
