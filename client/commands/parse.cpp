#include "client/commands/parse.h"

#include "client/commands/job_options.h"
#include "client/commands/network_options.h"
#include "client/commands/option_film.h"
#include "client/commands/option_parts.h"
#include "client/net/connection.h"
#include "client/requests/difference.h"
#include "client/requests/generator.h"
#include "client/requests/scene_source.h"

#include <algorithm>
#include <charconv>
#include <limits>
#include <map>
#include <memory>
#include <set>
#include <string_view>
#include <type_traits>
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

void declare(CLI::App& app, LoadOptions& load) {
    app.add_option(
           "SOURCE", load.source,
           "FILE.glb, FILE.gltf or FILE.npy; builtin:NAME[?key=value&...], root:PATH, or - for "
           "such a file on stdin, with --name")
        ->required();
    app.add_option("--name", load.name,
                   "name of the scene (the file's stem; forest for builtin:forest?trees=5)");
    app.add_flag("--replace", load.replace, "put it in the place of the scene of that name, as a new epoch");
    add_share(app, load);
    app.add_option("--build", load.build, "medium | fast | high: more time for the build makes faster trees");
    app.add_option_function<std::vector<std::string>>(
           "--set-mask",
           [&load](const std::vector<std::string>& rules) {
               for (const std::string& rule : rules)
                   if (const auto good = check_mask_rule(rule); !good)
                       throw CLI::ValidationError("--set-mask", good.error().message);
               load.masks = rules;
           },
           "GLOB=HEX: the mask of placements whose path is GLOB or lies below it, where * stands "
           "for "
           "any text; may be repeated, the last match wins (see: query --mask)")
        ->take_all()
        ->allow_extra_args(false);
    app.add_option("--primitive", load.primitive,
                   "type of the records in a .npy: sphere, or one of a loaded pack");
    app.add_option("--instances", load.instances, "FILE.npy of shape (N, 3, 4): where the records of a .npy are placed");
    add_point(app, "--origin",
              "a point near a scene that lies far from zero; it is subtracted, so that coordinates "
              "keep their digits. Rays and answers stay in the world",
              [&load](const WorldPoint& point) { load.origin = point; });
}

void declare(CLI::App&, ScenesOptions&) {}
void declare(CLI::App&, VariantsOptions&) {}
void declare(CLI::App&, StatsOptions&) {}
void declare(CLI::App& app, InfoOptions& info) {
    add_scene(app, info.scene);
    app.add_flag("--meshes", info.meshes, "list its meshes: triangles of one copy, and placements");
    app.add_flag("--materials", info.materials,
                 "list its materials: alpha mode, and what uses them");
}
void declare(CLI::App& app, UnloadOptions& unload) {
    CLI::Option* scenes =
        app.add_option("SCENE", unload.scenes, "names of loaded scenes (see: raynest scenes)");
    CLI::Option* all = app.add_flag("--all", unload.all, "every scene of yours")->excludes(scenes);
    add_parsed(
        app, "--idle",
        [&unload](const std::string& text) -> std::string {
            const auto milliseconds = parse_duration(text);
            if (!milliseconds) return milliseconds.error().message;
            unload.idle_ms = *milliseconds;
            return "";
        },
        "every scene of yours that has not been used for this long: 90s, 30m, 1h, 2d")
        ->excludes(scenes)
        ->excludes(all);
    app.parse_complete_callback([&unload] {
        if (unload.scenes.empty() && !unload.all && unload.idle_ms == 0)
            throw CLI::RequiredError("SCENE, --all or --idle");
    });
}

void declare(CLI::App& app, PathOptions& path) {
    add_scene(app, path.scene);
    app.add_option("PATH", path.path, "the path of a hit: its id, or its text as birch-17/leaves")
        ->required();
    add_epoch(app, path.epoch);
}

void declare(CLI::App& app, RenderOptions& render) { add_render(app, render); }
void declare(CLI::App& app, ResumeOptions& resume) { add_resume(app, resume); }

void declare(CLI::App& app, QueryOptions& query) {
    add_job(app, query.job);
    CLI::Option_group& rays = *app.add_option_group("Rays", "one of");
    rays.require_option(1);
    const auto parse_rays = [&query](const std::vector<std::string>& texts) {
        for (const std::string& text : texts) {
            const auto ray = parse_ray(text);
            if (!ray) throw CLI::ValidationError("--ray", ray.error().message);
            query.rays.push_back(*ray);
        }
    };
    rays.add_option_function<std::vector<std::string>>(
            "--ray", parse_rays, std::string(ray_form) + ", in the order of files; may be repeated")
        ->take_all()
        ->allow_extra_args(false);
    CLI::Option* file =
        rays.add_option("--rays", query.rays_file,
                        "FILE.npy of shape (N, 6): o d, or (N, 8): ox oy oz tmin dx dy dz tmax, "
                        "or with --from (N, 3): d; - for stdin");
    rays.add_option_function<std::vector<std::string>>(
            "--generate",
            [&query](const std::vector<std::string>& words) {
                if (const auto parsed = parse_generate(words); !parsed)
                    throw CLI::ValidationError("--generate", parsed.error().message);
                query.generate = words;
            },
            "KIND key=value...: the daemon makes them, as listed below")
        ->expected(1, -1);
    add_point(app, "--from", "start of all rays; --rays then holds their directions",
              [&query](const WorldPoint& point) { query.from = point; })
        ->needs(file);
    add_parsed(
        app, "--origin",
        [](const std::string&) -> std::string {
            return "is an option of load, and the scene keeps it; where rays start is said with "
                   "--from x,y,z";
        },
        "")
        ->group("");
    app.footer(generate_help() + exit_codes());
    add_kind(app, query.kind, query.max_hits, query.fields);
    app.add_option("--reduce", query.reduce,
                   "one row per point or path instead of one per ray: " + alternatives(reduce_words));
    add_output(app, query.output, {".npz"}, "FILE.npz (else a table on stdout)");
    add_detach(app, query.job, nullptr);
}

void declare(CLI::App& app, HeatmapOptions& heatmap) {
    add_job(app, heatmap.job);
    add_camera(app, heatmap.camera);
    add_output(app, heatmap.output, {".png", ".exr", ".npy", ".html"},
               "FILE.png with a legend; FILE.exr of every metric and level, FILE.npy of raw counts; "
               "FILE.html, a report to attach to a ticket");
    add_detach(app, heatmap.job, &heatmap.output);
    app.add_option("--metric", heatmap.metric,
                   alternatives(metric_words) + " (total); boxes.1 is level 1 alone");
    app.add_option("--palette", heatmap.palette, alternatives(palette_words));
    app.add_option("--scale", heatmap.scale, "linear | log");
    CLI::Option* range = app.add_option("--range", heatmap.range,
                                        "p99 | auto | LOW:HIGH; of a difference -HIGH:HIGH");
    app.add_option("--range-from", heatmap.range_from,
                   "FILE.exr of a heat map whose range this one takes")
        ->excludes(range);
    app.add_option("--count", heatmap.count, "traversed | necessary");
    add_each(
        app, "--diff",
        [&heatmap](const std::string& text) {
            if (!heatmap.difference) heatmap.difference.emplace();
            return read_difference(text, *heatmap.difference);
        },
        "subtract what the same rays cost in OTHER_SCENE, or with KEY=VALUE: intersector, mask, "
        "epoch, or a parameter of the intersector; may be repeated. Red costs more than that, blue "
        "less");
    add_each(
        app, "--fail-if",
        [&heatmap](const std::string& text) -> Result<void> {
            auto check = parse_fail_if(text);
            if (!check) return tl::unexpected<Failure>(check.error());
            heatmap.fail_if.push_back(std::move(*check));
            return {};
        },
        "'METRIC[.LEVEL].STATISTIC OP NUMBER', as 'total.p99>120', or 'levels|bytes|triangles OP "
        "NUMBER': end with exit code 9 where that is true; may be repeated. Statistics: min mean p50 "
        "p90 p99 max; OP: > >= < <=. With it no -o is needed");
    CLI::Option* top = add_whole(
        app, "--top", heatmap.top, 1U, static_cast<std::uint32_t>(protocol::Limits{}.list_items_max),
        "print so many of the instances, meshes and materials that most work is spent in, and a "
        "diagnosis; with it no -o is needed");
    add_whole(app, "--level", heatmap.level, 1U, 31U,
              "of --top: group by the instances of that level, 1 for those of the root (the "
              "innermost)")
        ->needs(top);
    app.parse_complete_callback([&heatmap] {
        const bool is_report = extension_of(heatmap.output) == ".html";
        if (heatmap.output.empty() && !heatmap.job.detach && heatmap.top == 0 &&
            heatmap.fail_if.empty())
            throw CLI::RequiredError("--output, --top or --fail-if");
        if (!heatmap.output.empty() && heatmap.job.detach && heatmap.top != 0)
            throw CLI::ValidationError("--detach", "takes one job: ask for -o or for --top");
        if (heatmap.job.detach && (is_report || !heatmap.fail_if.empty()))
            throw CLI::ValidationError("--detach", "ends before there is an answer: leave it out "
                                                   "with --fail-if and a report");
    });
}

void declare(CLI::App& app, ExplainOptions& explain) {
    add_job(app, explain.job);
    add_camera(app, explain.camera);
    CLI::Option* pixel = add_parsed(
        app, "--pixel",
        [&explain](const std::string& text) -> std::string {
            const auto numbers = parse_pixel(text);
            if (!numbers) return numbers.error().message;
            explain.pixel = *numbers;
            return "";
        },
        "the pixel of the camera's picture, from 0,0 in its upper left corner");
    pixel->type_name("X,Y");
    CLI::Option* ray = add_parsed(
        app, "--ray",
        [&explain](const std::string& text) -> std::string {
            const auto parsed = parse_ray(text);
            if (!parsed) return parsed.error().message;
            explain.ray = *parsed;
            return "";
        },
        std::string(ray_form) + ", in place of a pixel");
    ray->excludes(pixel);
    for (const char* other : {"--camera", "--lookat", "--fov", "--size"})
        ray->excludes(app.get_option(other));
    app.add_flag("--all", explain.all, "all steps of a long traversal, not the first 256");
    add_light(app, explain,
              "the rays of a path in place of a traversal: ao | direct | path, as render has them");
    add_whole(app, "--sample", explain.sample, 0U,
              static_cast<std::uint32_t>(protocol::Limits{}.samples_max - 1),
              "of an integrator: the sample of the pixel whose path is shown (0)");
    ray->excludes(app.get_option("--integrator"));
    for (const char* other : {"--seed", "--depth", "--ao-distance", "--env", "--sun", "--sample"})
        app.get_option(other)->needs(app.get_option("--integrator"));
    app.parse_complete_callback([&explain] {
        if (!explain.ray && !explain.pixel) throw CLI::RequiredError("--ray or --pixel");
    });
}

void declare(CLI::App& app, LoadTestOptions& load_test) {
    add_job(app, load_test.job);
    add_kind(app, load_test.kind, load_test.max_hits, load_test.fields);
    add_whole(app, "--clients", load_test.clients, 1U, 1000U, "connections at the same time (1)");
    add_whole(app, "--rays", load_test.rays, 1U,
              static_cast<std::uint32_t>(protocol::Limits{}.chunk_rays_max),
              "rays of each request (1)");
    add_number(app, "--seconds", load_test.seconds, 0.1, 86400.0,
               "a number of seconds from 0.1 to 86400",
               "time to measure the daemon, and then each control (5)");
    add_number(app, "--rate", load_test.rate, 0.1, 1.0e7, "a number from 0.1 to 10000000",
               "requests per second of all clients (else each client sends when it has its "
               "answer). Times count from when a request is due; one that is 5 s late is MISSED");
}

/// The subcommands. Each has a name, an example, a line of text, and the options that its
/// declare() adds.
class Subcommands {
public:
    Subcommands(CLI::App& app, Options& options) : app_(app), options_(options) {
        add<LoadOptions>("load", "load forest.glb --name forest",
                         "upload a scene, or have the daemon make one");
        add<ScenesOptions>("scenes", "scenes", "list the loaded scenes");
        add<InfoOptions>("info", "info forest", "describe a scene");
        add<PathOptions>("path", "path forest 77", "turn a path id into text, or text into an id");
        add<UnloadOptions>("unload", "unload forest", "drop a scene");
        add<VariantsOptions>("variants", "variants", "list intersectors and their parameters");
        add<StatsOptions>("stats", "stats", "print the daemon's counters");
        add<RenderOptions>(
            "render",
            "render forest -o forest.png\n"
            "  raynest render forest --integrator path --spp 64 --env sky -o forest.exr",
            "make a picture");
        add<ResumeOptions>("resume", "resume forest.exr --spp 256",
                           "add samples to a lit picture");
        add<QueryOptions>(
            "query",
            "query forest --ray 0,1,5,0,0,-1\n"
            "  raynest query forest --generate lidar elevations=-15:15:16 "
            "azimuths=0:360:1800 lookat=0,2,0,0,2,-1 --fields t,position -o sweep.npz",
            "ask what rays hit");
        add<HeatmapOptions>("heatmap",
                            "heatmap forest -o cost.png\n"
                            "  raynest heatmap forest --top 10 -o report.html\n"
                            "  raynest --local heatmap forest.glb --fail-if 'total.p99>120'",
                            "draw what each pixel's ray costs, say why, and compare");
        add<ExplainOptions>("explain",
                            "explain forest --pixel 480,270\n"
                            "  raynest explain forest --pixel 480,270 --integrator path",
                            "show how one ray finds its hit, step by step; or the rays of a path");
        add<TopOptions>("top", "top", "watch the daemon work: jobs, rays per second, memory");
        add<OpenOptions>("open", "open forest", "show the daemon's page in the browser");
        add<JobsOptions>("jobs", "jobs", "list running jobs and kept answers");
        add<WaitOptions>("wait", "wait 17", "wait until a detached job has ended");
        add<FetchOptions>("fetch", "fetch 17 -o forest.png",
                          "get the answer of a detached job");
        add<CancelOptions>("cancel", "cancel 17", "end a job and drop its answer");
        add<LoadTestOptions>("load-test", "load-test forest --clients 8 --rays 64 --seconds 10",
                             "measure round trips and throughput, beside bare sockets");
        add<LoginOptions>("login", "login tls://gpu.example.org:31060",
                          "keep the token of a daemon, and copies of the certificates, for later "
                          "commands");
        add<LogoutOptions>("logout", "logout tls://gpu.example.org:31060",
                           "remove what `login` kept of a daemon");
        add<AdminOptions>("admin", "admin connections", "administer the daemon");
    }
    /// Returns the help of the chosen subcommand, or of the program; it begins with an example.
    [[nodiscard]] std::string help() const {
        const std::vector<CLI::App*> chosen = app_.get_subcommands();
        if (chosen.empty()) return examples + app_.help();
        return "Example:\n  raynest " + examples_.at(chosen[0]) + "\n\n" +
               chosen[0]->help("raynest");
    }
    /// Returns a message about the first unused word, which is an unknown option or subcommand, or
    /// "". CLI11 alone might complain of a missing option instead.
    [[nodiscard]] std::string complaint() const {
        const std::vector<std::string> words = app_.remaining(true);
        for (const std::string& word : words)
            if (word.starts_with("--")) return "there is no option " + word;
        for (const std::string& word : words)
            if (word.find('=') != std::string::npos && !app_.get_subcommands().empty())
                return "'" + word + "' stands alone: repeat --set before each NAME=VALUE";
        if (!app_.get_subcommands().empty() || words.empty()) return "";
        if (words[0].starts_with('-')) return "there is no option " + words[0];
        std::string names;
        for (const CLI::App* sub : app_.get_subcommands({}))
            names += (names.empty() ? "" : ", ") + sub->get_name();
        return "there is no subcommand '" + words[0] + "'; there are " + names;
    }
    [[nodiscard]] std::string see_also() const {
        const std::vector<CLI::App*> chosen = app_.get_subcommands();
        const std::string name = chosen.empty() ? "" : " " + chosen[0]->get_name();
        return "see: raynest" + name + " --help";
    }

private:
    template <class Command>
    void add(const char* name, const char* example, const char* text) {
        CLI::App* sub = app_.add_subcommand(name, text);
        const auto command = std::make_shared<Command>();
        declare(*sub, *command);
        for (CLI::Option* option : sub->get_options())
            option->check(CLI::Validator(complain_if_empty, ""));
        sub->fallthrough();
        sub->final_callback([this, command] { options_.command = *command; });
        examples_[sub] = example;
    }

    CLI::App& app_;
    Options& options_;
    std::map<const CLI::App*, std::string> examples_;
};

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
    return std::visit(
        [](const auto& command) -> Result<void> {
            using Command = std::decay_t<decltype(command)>;
            const JobOptions* job = nullptr;
            if constexpr (requires { command.job.detach; }) job = &command.job;
            const std::string* scene = job != nullptr ? &job->scene : nullptr;
            if constexpr (requires { command.scene.size(); }) scene = &command.scene;
            if (job != nullptr && job->detach)
                return fail(Exit::usage,
                            "--local ends its daemon with the command: leave --detach out");
            if (std::is_same_v<Command, LoginOptions> || std::is_same_v<Command, LogoutOptions>)
                return fail(Exit::usage, "login and logout name a daemon: leave --local out");
            if (std::is_same_v<Command, LoadTestOptions> || std::is_same_v<Command, TopOptions> ||
                std::is_same_v<Command, OpenOptions>)
                return fail(Exit::usage, "--local ends its daemon with the command, and this one "
                                         "needs a daemon that goes on: start raynestd");
            if constexpr (std::is_same_v<Command, HeatmapOptions>) {
                if (command.difference && !command.difference->scene.empty() &&
                    !is_source(command.difference->scene))
                    return fail(Exit::usage, "--local begins with no scene: name a file in place "
                                             "of '" + command.difference->scene + "'");
            }
            if (scene != nullptr && !is_source(*scene))
                return fail(Exit::usage, "--local begins with no scene: name a file in place of '" +
                                             *scene + "', such as " + *scene + ".glb");
            return {};
        },
        options.command);
}

}  // namespace

Result<Parsed> parse_options(int argc, const char* const* argv) {
    Options options;
    CLI::App app("raynest - trace rays through a daemon's scenes with the intersector you name",
                 "raynest");
    app.footer(exit_codes());
    app.require_subcommand(1);
    app.set_version_flag("--version", "raynest " RAYNEST_VERSION);
    app.add_option("--server", options.server,
                   "tcp://HOST:PORT, tls://HOST:PORT, unix:PATH or ssh://HOST (" + std::string(default_uri) +
                       ")")
        ->envname("RAYNEST_SERVER");
    add_access(app, options.access);
    app.add_flag("--local", options.local,
                 "start a raynestd for this command alone, with no scene but those it loads");
    app.add_flag("--json", options.json, "print answers and errors as JSON");
    app.add_flag("--quiet", options.quiet, "show no progress on the terminal");
    add_reconnect(app, options.reconnect);
    const Subcommands subcommands(app, options);
    const auto refuse = [&](const std::string& complaint) {
        return fail(Exit::usage, complaint + "; " + subcommands.see_also());
    };

    try {
        app.parse(argc, argv);
    } catch (const CLI::CallForHelp&) {
        const std::string complaint = subcommands.complaint();
        if (!complaint.empty()) return refuse(complaint);
        return Parsed{subcommands.help(), std::nullopt};
    } catch (const CLI::CallForVersion& version) {
        return Parsed{std::string(version.what()) + "\n", std::nullopt};
    } catch (const CLI::RequiredError& error) {
        const std::string complaint = subcommands.complaint();
        if (!complaint.empty()) return refuse(complaint);
        if (app.get_subcommands().empty()) {
            Failure advice = failure(Exit::usage, first_steps);
            advice.has_lines = true;
            return tl::unexpected(std::move(advice));
        }
        return refuse(plain_words(error.what()));
    } catch (const CLI::ParseError& error) {
        const std::string complaint = subcommands.complaint();
        return refuse(complaint.empty() ? error.what() : complaint);
    }
    if (const auto* login = std::get_if<LoginOptions>(&options.command)) options.server = login->uri;
    if (const auto* logout = std::get_if<LogoutOptions>(&options.command); logout && !logout->uri.empty())
        options.server = logout->uri;
    if (options.server.empty()) options.server = default_uri;
    if (auto useful = check_local(options); !useful) return refuse(useful.error().message);
    if (auto* heatmap = std::get_if<HeatmapOptions>(&options.command))
        heatmap->command_line = shell_words(argc, argv);
    return Parsed{"", std::move(options)};
}

}  // namespace raynest::client
