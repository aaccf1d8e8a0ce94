// raynest: the command line. Parses, connects, runs one subcommand, ends with its exit code.
#include "client/commands/commands.h"
#include "client/interrupt.h"
#include "client/output.h"

#include <cstdlib>
#include <exception>
#include <iostream>
#include <string_view>
#include <variant>

namespace {

using namespace raynest::client;

/// --json decides how errors read, even when the command line itself is wrong.
bool wants_json(int argc, const char* const* argv) {
    for (int i = 1; i < argc; ++i)
        if (std::string_view(argv[i]) == "--json") return true;
    return false;
}

int end_with(const Failure& failure, bool json) {
    std::cout.flush();
    std::cerr << describe(failure, json) << '\n';
    return static_cast<int>(failure.exit);
}

Result<void> connect_and_run(const Options& options) {
    const char* token = std::getenv("RAYNEST_TOKEN");
    const auto connect = [&] {
        return Connection::open(options.server, token != nullptr ? token : "");
    };
    Progress progress(Progress::style_for_stderr(options.quiet || options.json));
    const auto connection = connect();
    if (!connection) return tl::unexpected<Failure>(connection.error());
    Context context{**connection, progress, options.json, connect};
    return std::visit([&](const auto& command) { return run(context, command); }, options.command);
}

}  // namespace

int main(int argc, char** argv) {
    const bool json = wants_json(argc, argv);
    try {
        const auto parsed = parse_options(argc, argv);
        if (!parsed) return end_with(parsed.error(), json);
        catch_interrupts();
        if (!parsed->options)
            std::cout << parsed->text;
        else if (const auto done = connect_and_run(*parsed->options); !done)
            return end_with(done.error(), json);
        const auto written = check_stdout();
        return written ? 0 : end_with(written.error(), json);
    } catch (const std::exception& thrown) {
        return end_with(failure(Exit::failed, thrown.what()), json);
    }
}
