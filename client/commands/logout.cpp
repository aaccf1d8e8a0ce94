// raynest logout [URI]: removes what `raynest login` kept of a daemon. It needs no connection.
#include "client/commands/command.h"
#include "client/ground/json.h"
#include "client/net/hosts.h"
#include "client/output/output.h"

#include <iostream>

namespace raynest::client {
namespace {

/// Removes what `login` kept.
struct LogoutOptions {
    std::string uri;  ///< empty: --server
};

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

}  // namespace

void declare(CommandLine& line, LogoutOptions& logout) {
    line.add_option("URI", logout.uri, "the daemon, as login was given it (--server)");
}

Result<void> run(Context& context, const LogoutOptions& /*options*/) {
    return log_out(context.uri, context.json);
}

namespace {

class Logout final : public CommandOf<LogoutOptions> {
    [[nodiscard]] const std::string* uri() const override { return &options_.uri; }
    [[nodiscard]] std::optional<Result<void>> run_alone(const std::string& uri,
                                                        bool json) const override {
        return log_out(uri, json);
    }
};

}  // namespace

std::unique_ptr<Command> make_logout() {
    return std::make_unique<Logout>();
}

}  // namespace raynest::client
