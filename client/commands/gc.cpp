// raynest gc: removes what is left of damaged and replaced scenes in the daemon's state folder.
#include "client/commands/commands.h"
#include "client/ground/json.h"
#include "client/output/output.h"

#include <iostream>

namespace raynest::client {

void declare(CommandLine& /*line*/, GcOptions& /*options*/) {}

Result<void> run(Context& context, const GcOptions& /*options*/) {
    wire::AdminT request;
    request.act = "gc";
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
