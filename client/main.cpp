// raynest: the command line. Parses, connects, runs one subcommand, ends with its exit code.
#include "client/commands/by_python.h"
#include "client/commands/commands.h"
#include "client/commands/may_repeat.h"
#include "client/commands/parse.h"
#include "client/ground/interrupt.h"
#include "client/ground/json.h"
#include "client/ground/python.h"
#include "client/net/local_daemon.h"
#include "client/net/reconnect.h"
#include "client/net/ssh_tunnel.h"
#include "client/output/output.h"
#include "client/output/output_file.h"
#include "client/requests/film.h"
#include "client/requests/generator.h"
#include "client/requests/scene_source.h"
#include "client/requests/tables.h"

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

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
template <class Command>
Result<void> load_first(Context& context, Command& command) {
    std::string* scene = nullptr;
    if constexpr (requires { command.job.scene; }) scene = &command.job.scene;
    if constexpr (requires { command.scene.size(); }) scene = &command.scene;
    if (scene == nullptr || !is_source(*scene)) return {};
    auto name = load_for_connection(context.connection, context.progress, *scene);
    if (!name) return tl::unexpected<Failure>(name.error());
    *scene = std::move(*name);
    return {};
}

/// How many parts a command may have at most, each with 50 ms of work or more; 0: it takes none.
template <class Command>
std::uint64_t parts_max(const Command& command) {
    constexpr std::uint64_t rays = 1 << 16;
    const auto of_rays = [](std::uint64_t all) { return std::max<std::uint64_t>(1, all / rays); };
    if constexpr (requires { command.rays_file; }) {
        const auto generate = parse_generate(command.generate);
        if (command.rays_file.empty() && command.rays.empty() && generate &&
            generate->points.empty())
            return of_rays(sensor_rays(generate->message));
        return 1;
    } else if constexpr (requires { command.part; }) {
        const CameraOptions& camera = command.camera;
        std::uint64_t samples = 1;
        if constexpr (requires { samples_of(command); }) samples = samples_of(command);
        return std::min<std::uint64_t>((camera.height + part_rows - 1) / part_rows,
                                       of_rays(samples * camera.width * camera.height));
    }
    return 0;
}

/// Makes this process the Python program that has a cluster carry out the command, or fails.
Failure become_dask(const Options& options) {
    if (options.local) return failure(Exit::usage, "--dask goes without --local");
    return std::visit(
        [&](const auto& command) -> Failure {
            if constexpr (requires { is_by_python(command); }) {
                const Access none;
                if (is_by_python(command))
                    return become_program(
                        command, {"", none, "", 0, options.json, options.dask, options.quiet});
            }
            const std::uint64_t parts = parts_max(command);
            if constexpr (requires {
                              command.part;
                              command.output;
                          }) {
                if (command.part.count != 0 || command.job.detach || is_stdout(command.output) ||
                    command.output.empty())
                    return failure(Exit::usage,
                                   "--dask needs -o FILE, and goes without --part and --detach");
                if (auto writable = check_writable(command.output); !writable)
                    return writable.error();
                std::vector<std::string> words = {options.dask, std::to_string(parts),
                                                  command.job.scene, command.output};
                words.insert(words.end(), options.words.begin(), options.words.end());
                if (options.quiet) words.insert(words.begin(), "--quiet");
                if (options.json) words.insert(words.begin(), "--json");
                return become_python("raynest._command", std::move(words));
            }
            return failure(Exit::usage, "--dask is for render, heatmap and query");
        },
        options.command);
}

Result<void> connect_and_run(Options options) {
    if (const auto* merge = std::get_if<MergeOptions>(&options.command))
        return tl::unexpected<Failure>(become_merge(*merge, options.json));
    const auto of_python = std::visit(
        [&](const auto& command) -> Result<bool> {
            if constexpr (requires { is_by_python(command); }) {
                if (!is_by_python(command)) return false;
                if (auto fits = check_by_python(command); !fits)
                    return tl::unexpected<Failure>(fits.error());
                return true;
            }
            return false;
        },
        options.command);
    if (!of_python) return tl::unexpected<Failure>(of_python.error());
    if (!options.dask.empty()) return tl::unexpected<Failure>(become_dask(options));
    std::optional<LocalDaemon> local;
    if (options.local) {
        auto started = LocalDaemon::start();
        if (!started) return tl::unexpected<Failure>(started.error());
        local.emplace(std::move(*started));
        options.server = local->uri();
    }
    if (std::holds_alternative<LogoutOptions>(options.command))
        return log_out(options.server, options.json);
    auto access = options.local ? Result<Access>() : find_access(options.server, options.access);
    if (!access) return tl::unexpected<Failure>(access.error());
    for (const std::string& warning : access->warnings) print_note(warning);
    if (!access->tls.verify)
        print_note("--tls-verify off: whoever answers at " + options.server + " is trusted");
    if (std::holds_alternative<LoginOptions>(options.command)) {
        auto token = ask_token(options.server);
        if (!token) return tl::unexpected<Failure>(token.error());
        access->token = std::move(*token);
        if (auto secret = check_secrecy(options.server, access->token); !secret) return secret;
    }
    if (*of_python)
        return tl::unexpected<Failure>(std::visit(
            [&](const auto& command) -> Failure {
                if constexpr (requires { is_by_python(command); })
                    return become_program(command,
                                          {options.server, *access, local ? local->folder() : "",
                                           options.local ? 0 : options.reconnect, options.json});
                std::abort();
            },
            options.command));
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
    for (int attempt = 1;; ++attempt) {
        CommandOptions command = options.command;
        Context context{**connection, progress, options.json, connect, options.server, *access};
        auto done = std::visit(
            [&](auto& chosen) -> Result<void> {
                if (auto loaded = load_first(context, chosen); !loaded) return loaded;
                if constexpr (requires { chosen.job.hide; }) {
                    if (auto read = read_tables(chosen.job.settings, chosen.job.tables); !read)
                        return read;
                }
                if constexpr (requires { chosen.difference; })
                    if (auto& other = chosen.difference)
                        if (auto read = read_tables(other->settings, other->tables); !read)
                            return read;
                return run(context, chosen);
            },
            command);
        const bool again = !done && patience > 0 && attempt < attempts_max &&
                           may_repeat(options.command, done.error(), stdout_watch.printed());
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
