#include "client/commands/by_python.h"

#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/ground/lists.h"
#include "client/ground/numbers.h"
#include "client/ground/python.h"
#include "client/output/output_file.h"
#include "client/requests/scene_source.h"
#include "client/requests/tables.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

namespace raynest::client {
namespace {

/// An option of `query` and the argument of measure() that it is.
struct MeasureWord {
    const char* option;
    const char* argument;
    const char* text;
    bool is_whole = false;
};
constexpr std::array measure_words = {
    MeasureWord{"--returns", "returns",
                "most returns of a beam of --generate lidar or sweep: makes a row for each return "
                "instead of each ray, with intensity; by the Python package, for -o FILE",
                true},
    MeasureWord{"--divergence", "divergence", "radians by which a beam spreads, in all (0)"},
    MeasureWord{"--footprint", "footprint", "rays per spreading beam (19)", true},
    MeasureWord{"--resolution", "resolution",
                "surfaces of a beam that are nearer to each other make one return (0.3)"},
    MeasureWord{"--threshold", "threshold", "least share of a beam that makes a return (0)"},
    MeasureWord{"--noise", "noise", "standard deviation of the distances (0)"},
    MeasureWord{"--seed", "seed", "seed of the noise (0)", true}};

std::string read_measure(const MeasureWord& word, const std::string& text, QueryOptions& query) {
    Json value;
    if (word.is_whole) {
        std::uint64_t number = 0;
        const char* const end = text.data() + text.size();
        const auto [last, error] = std::from_chars(text.data(), end, number);
        if (error != std::errc{} || last != end) return "'" + text + "' is not a whole number";
        value = number;
    } else {
        const auto number = parse_world(text, 1, 1, "a number");
        if (!number) return number.error().message;
        if (!std::isfinite(number->front())) return "'" + text + "' is not finite";
        value = number->front();
    }
    query.measure.emplace_back(word.argument, value.dump());
    return "";
}

/// The words that raynest._query reads of every command.
Json document_of(const JobOptions& job, const std::string& output, const DaemonPlace& place) {
    const TlsOptions& tls = place.access.tls;
    Json access{{"verify", tls.verify}, {"reconnect", place.reconnect}};
    const auto add = [](Json& to, const char* name, const auto& value, const auto& absent) {
        if (value != absent) to[name] = value;
    };
    const std::string none;
    add(access, "token", place.access.token, none);
    add(access, "ca", tls.ca, none);
    add(access, "cert", tls.certificate, none);
    add(access, "key", tls.key, none);
    Json asked = Json::object();
    add(asked, "intersector", job.intersector, none);
    add(asked, "traversal", job.traversal, none);
    add(asked, "mask", job.mask, 0xFFFFFFFFU);
    add(asked, "epoch", job.epoch, std::uint64_t{0});
    add(asked, "worker", job.worker, none);
    add(asked, "priority", job.priority, none);
    add(asked, "deadline", job.deadline, 0.0);
    add(asked, "hide", job.hide, std::vector<std::string>());
    add(asked, "only", job.only, std::vector<std::string>());
    add(asked, "skip_hidden_boxes", job.skip_hidden_boxes, false);
    add(asked, "animation", job.animation, none);
    if (job.time) asked["time"] = *job.time;
    Json tables = Json::object();
    for (const TableOption& table : job.tables) tables[table.name] = table.values;
    return Json{{"server", place.uri},         {"access", std::move(access)},
                {"folder", place.folder},      {"json", place.json},
                {"dask", place.dask},          {"quiet", place.quiet},
                {"scene", job.scene},          {"is_source", is_source(job.scene)},
                {"job", std::move(asked)},     {"set", job.settings},
                {"tables", std::move(tables)}, {"output", output}};
}

/// The words that QueryOptions holds.
Json document_of(const QueryOptions& query, const DaemonPlace& place) {
    Json document = document_of(query.job, query.output, place);
    if (query.time_step != 0) document["job"]["time_step"] = query.time_step;
    Json measure = Json::object();
    for (const auto& [argument, value] : query.measure) measure[argument] = Json::parse(value);
    if (!query.prefer.empty()) measure["prefer"] = query.prefer;
    Json rays = Json::array();
    for (WorldRay ray : query.rays) {
        // JSON has no infinity, and float32 no larger number.
        ray[7] = std::min(ray[7], double{std::numeric_limits<float>::max()});
        rays.push_back(ray);
    }
    document.update(Json{{"generate", query.generate},
                         {"measure", std::move(measure)},
                         {"rays", std::move(rays)},
                         {"rays_file", query.rays_file},
                         {"from", query.from ? Json(*query.from) : Json()},
                         {"masks_file", query.masks_file},
                         {"times_file", query.times_file},
                         {"kind", query.kind.empty() ? Json() : Json(query.kind)},
                         {"max_hits", query.max_hits == 0 ? Json() : Json(query.max_hits)},
                         {"fields", query.fields}});
    return document;
}

/// The words that RenderOptions holds of a camera in motion.
Json document_of(const RenderOptions& render, const DaemonPlace& place) {
    Json document = document_of(render.job, render.output, place);
    document["film"] =
        Json{{"trajectory", render.trajectory},
             {"begin", render.begin},
             {"readout", render.readout},
             {"step_error", render.step_error == 0 ? Json() : Json(render.step_error)},
             {"fov", render.camera.fov_degrees},
             {"size", {render.camera.width, render.camera.height}}};
    return document;
}

bool measures(const QueryOptions& query) {
    return !query.measure.empty() || !query.prefer.empty();
}

}  // namespace

void add_measure(CommandLine& line, QueryOptions& query) {
    for (const MeasureWord& word : measure_words)
        line.add_parsed(
                word.option,
                [&query, &word](const std::string& text) {
                    return read_measure(word, text, query);
                },
                word.text)
            .type_name("NUMBER");
    line.add_option("--prefer", query.prefer, "which returns a beam keeps (nearest)")
        .one_of({"nearest", "strongest"});
    line.add_option("--times", query.times_file,
                    "FILE.npy of shape (N,): for each ray that is sent the moment of the scene's "
                    "animation, in seconds; by the Python package, for -o FILE.npz");
    line.add_number("--time-step", query.time_step, 1e-9, 1e9,
                    "a number of seconds from 1e-9 to 1e9",
                    "with --times, or with --returns of a sweep: the scene moves in steps of this "
                    "length");
}

void add_trajectory(CommandLine& line, RenderOptions& render) {
    const Option trajectory = line.add_option(
        "--trajectory", render.trajectory,
        "FILE.npy of rows of a time and a 3x4 pose: the camera moves while its rows are read, from "
        "top to bottom, as a rolling shutter has it. It looks along -z, with x to the right and y "
        "up; the colours are those of primary; by the Python package. Example: raynest render "
        "SCENE --trajectory way.npy --readout 0.03 -o out.png");
    line.add_number("--begin", render.begin, -1e9, 1e9, "a number of seconds from -1e9 to 1e9",
                    "when the first row is read (0)")
        .needs(trajectory);
    line.add_number("--readout", render.readout, 0.0, 1e9, "a number of seconds from 0 to 1e9",
                    "how long the reading of all rows takes (0)")
        .needs(trajectory);
    line.add_number("--step-error", render.step_error, 1e-9, 1e9,
                    "a number of metres from 1e-9 to 1e9",
                    "an animated scene moves meanwhile, and no part is further "
                    "than this from where it should be")
        .needs(trajectory);
}

bool is_by_python(const QueryOptions& query) {
    return measures(query) || !query.times_file.empty() || query.time_step != 0;
}

bool is_by_python(const RenderOptions& render) {
    return !render.trajectory.empty();
}

Result<void> check_by_python(const RenderOptions& render) {
    const bool is_lit = !render.integrator.empty() && render.integrator != "primary";
    for (const auto& [given, option] : {std::pair{!render.camera.name.empty(), "--camera"},
                                        {!render.camera.look_at.empty(), "--lookat"},
                                        {render.all_cameras, "--cameras"},
                                        {is_lit, "--integrator"},
                                        {render.samples != 0, "--spp"},
                                        {render.seed != 0, "--seed"},
                                        {!render.environment.empty(), "--env"},
                                        {render.environment_rotate != 0, "--env-rotate"},
                                        {render.sun.has_value(), "--sun"},
                                        {render.noise != 0, "--noise"},
                                        {!render.tonemap.empty(), "--tonemap"},
                                        {!render.exposure.empty(), "--exposure"},
                                        {render.progressive, "--progressive"},
                                        {render.job.detach, "--detach"},
                                        {render.part.count != 0, "--part"}})
        if (given) return fail(Exit::usage, std::string("--trajectory goes without ") + option);
    std::string other;
    each_setting(
        [&](const SettingWords& setting, auto value) {
            if (value != 0) other = setting.option;
        },
        render);
    if (!other.empty()) return fail(Exit::usage, "--trajectory goes without " + other);
    const std::string ending = extension_of(render.output);
    if (is_stdout(render.output) || (ending != ".png" && ending != ".npy"))
        return fail(Exit::usage, "--trajectory needs -o FILE.png or FILE.npy");
    return check_writable(render.output);
}

Result<void> check_by_python(const QueryOptions& query) {
    const bool is_measured = measures(query), is_timed = !query.times_file.empty();
    const std::string word = is_measured ? "--returns" : is_timed ? "--times" : "--time-step";
    const auto without = [&](bool given, const char* option) -> Result<void> {
        if (!given) return {};
        return fail(Exit::usage, word + " and its like go without " + option);
    };
    if (!is_measured && !is_timed)
        return fail(Exit::usage, "--time-step is for --times and --returns");
    if (is_measured && is_timed)
        return fail(Exit::usage, "--times are of rays that are sent: leave it out, or --returns");
    if (is_measured && query.generate.empty())
        return fail(Exit::usage, "--returns and its like need --generate lidar or sweep");
    if (is_timed && !query.generate.empty())
        return fail(Exit::usage,
                    "--times are of rays that are sent: --generate has those of its sensor");
    for (const auto& [given, option] : {std::pair{query.job.detach, "--detach"},
                                        {query.part.count != 0, "--part"},
                                        {!query.reduce.empty(), "--reduce"},
                                        {is_timed && query.job.time.has_value(), "--time"},
                                        {is_measured && !query.kind.empty(), "--kind"},
                                        {is_measured && query.max_hits != 0, "--max-hits"},
                                        {is_measured && !query.masks_file.empty(), "--masks"}})
        if (auto fits = without(given, option); !fits) return fits;
    if (is_measured && !query.step_error.empty())
        return fail(Exit::usage, "--returns goes without --step-error: say --time-step SECONDS");
    if (query.output.empty() || is_stdout(query.output) ||
        (is_timed && extension_of(query.output) != ".npz"))
        return fail(Exit::usage, word + (is_timed ? " needs -o FILE.npz" : " needs -o FILE"));
    return check_writable(query.output);
}

namespace {

template <class Command>
Failure become(Command command, const DaemonPlace& place) {
    if (auto read = read_tables(command.job.settings, command.job.tables); !read)
        return read.error();
    const std::string document = document_of(command, place).dump();
    // A word of a command line is seen by all, and is short.
    const int file = ::memfd_create("command", 0);
    if (file < 0 ||
        ::write(file, document.data(), document.size()) != static_cast<ssize_t>(document.size()))
        return failure(Exit::failed,
                       std::string("cannot tell Python the command: ") + std::strerror(errno));
    std::vector<std::string> words = {"/dev/fd/" + std::to_string(file)};
    if (place.json) words.insert(words.begin(), "--json");
    if (place.dask.empty()) return become_python("raynest._query", std::move(words));
    words.insert(words.begin(), "--several");
    return become_python("raynest._command", std::move(words));
}

}  // namespace

Failure become_program(QueryOptions query, const DaemonPlace& place) {
    return become(std::move(query), place);
}

Failure become_program(RenderOptions render, const DaemonPlace& place) {
    return become(std::move(render), place);
}

}  // namespace raynest::client
