#include "client/commands/parse.h"

#include "client/arguments/shared_options.h"
#include "client/net/connection.h"
#include "client/requests/scene_source.h"

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

constexpr const char* examples = R"(Example:
  raynest load forest.glb
  raynest render forest -o forest.png
  raynest query forest --ray 0,1,5,0,0,-1
  raynest heatmap forest -o cost.png

)";

/// The answer to a command line without a command: three commands that work.
constexpr const char* first_steps = R"(say what to do. While a daemon runs (raynestd &), these work:
  raynest load builtin:forest
  raynest query forest --ray 8,50,-8,0,-1,0
  raynest render forest -o forest.png
raynest --help lists all that there is)";

/// Options before the command that say how to reach and convince a daemon. The token has none: the
/// command line is visible to other users.
void add_access(CommandLine& line, AccessOptions& access) {
    line.add_option("--ca", access.tls.ca,
                    "PEM file of the CAs to trust with tls:// (RAYNEST_CA, else the system's)");
    line.add_option(
        "--token-file", access.token_file,
        "file with the token, mode 0600 (RAYNEST_TOKEN, else what `raynest login` kept)");
    line.add_option("--cert", access.tls.certificate,
                    "PEM file of this client's certificate (RAYNEST_CERT)");
    line.add_option("--key", access.tls.key, "PEM file of its key (RAYNEST_KEY)");
    line.add_parsed(
            "--tls-verify",
            [&access](const std::string& word) {
                access.tls.verify = word == "on";
                return "";
            },
            "on | off: off accepts any certificate, also an attacker's (on)")
        .one_of({"on", "off"});
}

void add_reconnect(CommandLine& line, double& seconds) {
    line.add_parsed(
            "--reconnect",
            [&seconds](const std::string& text) -> std::string {
                char* end = nullptr;
                seconds = std::strtod(text.c_str(), &end);
                const bool is_number = !text.empty() && *end == '\0';
                return is_number && seconds >= 0 && seconds <= 3600
                           ? ""
                           : "'" + text + "' is not 0 to 3600";
            },
            "seconds to look for a daemon that went away, as in a restart, and then to run the "
            "command again where that is safe; 0: never (10)")
        .environment_name("RAYNEST_RECONNECT")
        .type_name("FLOAT");
}

// The column `repeat` of the commands: true if a second run does more than the first.
namespace acts {
constexpr bool again = false, once = true;
#define RAYNEST_REQUEST(number, Name, handler, needs, role, repeat, ...) \
    constexpr bool Name = repeat;
#include "protocol/lists/requests.def"
}  // namespace acts

void add_command(Program& program, Options& options, const char* word, bool acts,
                 std::shared_ptr<Command> command, const char* example, const char* text) {
    program.add_command(
        word, example, text, [command](CommandLine& line) { command->declare_options(line); },
        [&options, word, acts, command] {
            options.word = word;
            options.acts = acts;
            options.command = command;
        });
}

void add_commands(Program& program, Options& options) {
#define RAYNEST_COMMAND(name, repeat, ...) \
    add_command(program, options, #name, acts::repeat, make_##name(), __VA_ARGS__);
#include "client/commands/commands.def"
}

/// Returns the command as a shell takes it: words with other than plain letters are quoted.
std::string shell_words(int argc, const char* const* argv) {
    constexpr std::string_view plain =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_./:,=+@%";
    std::string text = "raynest";
    for (int i = 1; i < argc; ++i) {
        const std::string_view word = argv[i];
        text += ' ';
        if (!word.empty() && word.find_first_not_of(plain) == std::string_view::npos) {
            text += word;
            continue;
        }
        text += '\'';
        for (const char c : word) text += c == '\'' ? "'\\''" : std::string(1, c);
        text += '\'';
    }
    return text;
}

/// A private daemon ends with its command, and knows only what that loads.
Result<void> check_local(const Options& options) {
    if (!options.local) return {};
    const JobOptions* const job = options.command->job();
    if (job != nullptr && job->detach)
        return fail(Exit::usage, "--local ends its daemon with the command: leave --detach out");
    if (options.command->uri() != nullptr)
        return fail(Exit::usage, "login and logout name a daemon: leave --local out");
    if (options.command->needs_lasting_daemon())
        return fail(Exit::usage,
                    "--local ends its daemon with the command, and this one needs a daemon that "
                    "goes on: start raynestd");
    const std::string* const other = options.command->other_scene();
    if (other != nullptr && !other->empty() && !is_source(*other))
        return fail(Exit::usage,
                    "--local begins with no scene: name a file in place of '" + *other + "'");
    const std::string* const scene = options.command->scene();
    if (scene != nullptr && !is_source(*scene))
        return fail(Exit::usage, "--local begins with no scene: name a file in place of '" +
                                     *scene + "', such as " + *scene + ".glb");
    return {};
}

}  // namespace

Result<Parsed> parse_options(int argc, const char* const* argv) {
    Options options;
    Program program({"raynest - trace rays through a daemon's scenes with the intersector you name",
                     "raynest " RAYNEST_VERSION, examples, first_steps, exit_codes()});
    CommandLine line = program.line();
    line.add_option("--server", options.server,
                    "tcp://HOST:PORT, tls://HOST:PORT, unix:PATH or ssh://HOST (" +
                        std::string(default_uri) + ")")
        .environment_name("RAYNEST_SERVER");
    add_access(line, options.access);
    line.add_flag("--local", options.local,
                  "start a raynestd for this command alone, with no scene but those it loads");
    line.add_option(
            "--dask", options.dask,
            "tcp://HOST:PORT of a Dask scheduler: its workers make the parts of a render, heatmap "
            "or query, each with a raynestd of its own; scene, rays and other files travel there")
        .filled();
    line.add_flag("--json", options.json, "print answers and errors as JSON");
    line.add_flag("--quiet", options.quiet, "show no progress on the terminal");
    add_reconnect(line, options.reconnect);
    add_commands(program, options);

    auto text = program.parse(argc, argv);
    if (!text) return tl::unexpected<Failure>(text.error());
    if (!text->empty()) return Parsed{std::move(*text), std::nullopt};
    if (const std::string* uri = options.command->uri(); uri != nullptr && !uri->empty())
        options.server = *uri;
    if (options.server.empty()) options.server = default_uri;
    if (auto useful = check_local(options); !useful) return program.refuse(useful.error().message);
    if (!options.dask.empty()) {
        const char* const* const end = argv + argc;
        // RAYNEST_SERVER may be set for all commands, and says nothing of this one.
        if (std::any_of(argv + 1, end, [](std::string_view word) {
                return word == "--server" || word.starts_with("--server=");
            }))
            return program.refuse(
                "--dask goes without --server: each worker has a daemon of its own");
        options.words.assign(std::find(argv + 1, end, options.word), end);
        // It may stand behind the command, too, and is not for those who make the parts.
        for (auto word = options.words.begin(); word != options.words.end();) {
            if (*word == "--dask" && word + 1 != options.words.end())
                word = options.words.erase(word, word + 2);
            else
                word = word->starts_with("--dask=") ? options.words.erase(word) : word + 1;
        }
    }
    options.command->told(shell_words(argc, argv));
    return Parsed{"", std::move(options)};
}

}  // namespace raynest::client
