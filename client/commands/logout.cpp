// raynest logout [URI]: removes what `raynest login` kept of a daemon. It needs no connection.
#include "client/commands/commands.h"
#include "client/ground/json.h"
#include "client/net/hosts.h"
#include "client/output/output.h"

#include <iostream>

namespace raynest::client {

Result<void> log_out(const std::string& uri, bool json) {
    const auto removed = forget_host(uri);
    if (!removed) return tl::unexpected<Failure>(removed.error());
    if (json)
        print_json(Json{{"server", uri}, {"removed", *removed}});
    else
        std::cout << (*removed ? "logged out of " + uri +
                                     "; its token is valid until it is revoked there"
                               : "nothing is kept of " + uri)
                  << '\n';
    return {};
}

void declare(CommandLine& line, LogoutOptions& logout) {
    line.add_option("URI", logout.uri, "the daemon, as login was given it (--server)");
}

Result<void> run(Context& context, const LogoutOptions& /*options*/) {
    return log_out(context.uri, context.json);
}

}  // namespace raynest::client
