// raynest: the command line. Parses, connects, runs one subcommand, ends with its exit code.
#include "client/commands/command.h"
#include "client/commands/parse.h"
#include "client/ground/interrupt.h"
#include "client/ground/json.h"
#include "client/ground/python.h"
#include "client/net/local_daemon.h"
#include "client/net/reconnect.h"
#include "client/net/ssh_tunnel.h"
#include "client/output/output.h"
#include "client/output/output_file.h"
#include "client/requests/scene_source.h"
#include "client/requests/tables.h"

#include <cstdlib>
#include <exception>
#include <iostream>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

namespace {

using namespace raynest::client;

/// Runs of a command whose daemon goes away each time.
constexpr int attempts_max = 10;

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

/// Loads the file that a command names in the place of a scene.
Result<void> load_first(Context& context, Command& command) {
    std::string* const scene = command.scene();
    if (scene == nullptr || !is_source(*scene)) return {};
    auto name = load_for_connection(context.connection, context.progress, *scene);
    if (!name) return tl::unexpected<Failure>(name.error());
    *scene = std::move(*name);
    return {};
}

/// Makes this process the Python program that has a cluster carry out the command, or fails.
Failure become_dask(const Options& options, bool by_python) {
    if (options.local) return failure(Exit::usage, "--dask goes without --local");
    Command& command = *options.command;
    if (by_python) {
        const Access none;
        return command.become_program({"", none, "", 0, options.json, options.dask, options.quiet});
    }
    const std::optional<Parts> parts = command.parts();
    if (!parts) return failure(Exit::usage, "--dask is for render, heatmap and query");
    if (parts->is_one || command.job()->detach || is_stdout(parts->output) || parts->output.empty())
        return failure(Exit::usage, "--dask needs -o FILE, and goes without --part and --detach");
    if (auto writable = check_writable(parts->output); !writable) return writable.error();
    std::vector<std::string> words = {options.dask, std::to_string(parts->most),
                                      command.job()->scene, parts->output};
    words.insert(words.end(), options.words.begin(), options.words.end());
    if (options.quiet) words.insert(words.begin(), "--quiet");
    if (options.json) words.insert(words.begin(), "--json");
    name_daemon();  // it draws heat maps
    return become_python("raynest._command", std::move(words));
}

Result<void> connect_and_run(Options options) {
    Command& command = *options.command;
    const auto by_python = command.is_by_python();
    if (!by_python) return tl::unexpected<Failure>(by_python.error());
    if (!options.dask.empty()) return tl::unexpected<Failure>(become_dask(options, *by_python));
    if (auto done = command.run_alone(options.server, options.json)) return std::move(*done);
    std::optional<LocalDaemon> local;
    if (options.local) {
        auto started = LocalDaemon::start();
        if (!started) return tl::unexpected<Failure>(started.error());
        local.emplace(std::move(*started));
        options.server = local->uri();
    }
    auto access = options.local ? Result<Access>() : find_access(options.server, options.access);
    if (!access) return tl::unexpected<Failure>(access.error());
    for (const std::string& warning : access->warnings) print_note(warning);
    if (!access->tls.verify)
        print_note("--tls-verify off: whoever answers at " + options.server + " is trusted");
    if (auto known = command.identify(options.server, *access); !known) return known;
    if (*by_python)
        return tl::unexpected<Failure>(
            command.become_program({options.server, *access, local ? local->folder() : "",
                                    options.local ? 0 : options.reconnect, options.json}));
    std::optional<SshTunnel> tunnel;
    std::string uri = options.server;
    if (uri.starts_with("ssh://")) {
        auto opened = SshTunnel::open(uri);
        if (!opened) return tl::unexpected<Failure>(opened.error());
        uri = tunnel.emplace(std::move(*opened)).uri();
    }
    const auto connect = [&] {
        auto opened = Connection::open(uri, *access);
        if (!opened && tunnel) opened.error() = tunnel->explain(opened.error());
        return opened;
    };
    const double patience = options.local ? 0 : options.reconnect;
    Progress progress(Progress::style_for_stderr(options.quiet || options.json));
    auto connection = connect();
    if (!connection && patience > 0 && may_connect_again(connection.error())) {
        if (is_own(connection.error()) && !options.quiet && !options.json)
            print_note(connection.error().message + "; trying again");
        connection = reconnect(connect, patience, connection.error());
    }
    if (!connection) return tl::unexpected<Failure>(connection.error());
    if (local) local->hide();
    const PrintWatch stdout_watch(std::cout);
    if (JobOptions* const job = command.job())
        if (auto read = read_tables(job->settings, job->tables); !read) return read;
    std::string* const scene = command.scene();
    const std::string source = scene != nullptr ? *scene : "";
    for (int attempt = 1;; ++attempt) {
        Context context{**connection, progress, options.json, connect, options.server, *access};
        Result<void> done = load_first(context, command);
        if (done) done = command.carry_out(context);
        if (scene != nullptr) *scene = source;
        const bool again = !done && patience > 0 && attempt < attempts_max &&
                           may_repeat(command, options.acts, done.error(), stdout_watch.printed());
        if (!again) return done;
        progress.clear();
        if (!options.quiet && !options.json) print_note("the daemon went away; looking for it");
        connection = reconnect(connect, patience, done.error());
        if (!connection) return tl::unexpected<Failure>(connection.error());
    }
}

}  // namespace

int main(int argc, char** argv) {
    const bool json = wants_json(argc, argv);
    try {
        auto parsed = parse_options(argc, argv);
        if (!parsed) return end_with(parsed.error(), json);
        catch_interrupts();
        if (!parsed->options)
            std::cout << parsed->text;
        else if (const auto done = connect_and_run(std::move(*parsed->options)); !done)
            return end_with(done.error(), json);
        const auto written = check_stdout();
        return written ? 0 : end_with(written.error(), json);
    } catch (const Json::exception&) {  // only what a daemon sent is read by at()
        return end_with(daemon_sent("a document that lacks what it must hold").value(), json);
    } catch (const std::exception& thrown) {
        return end_with(failure(Exit::failed, thrown.what()), json);
    }
}
