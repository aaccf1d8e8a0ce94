#include "client/arguments/shared_options.h"

#include "client/files/files.h"
#include "client/ground/lists.h"
#include "client/ground/numbers.h"
#include "client/requests/generator.h"
#include "protocol/errors.h"
#include "protocol/limits.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <set>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::uint64_t part_count_max = 1 << 20;

/// Checks that all are name=value, each name once.
Result<void> check_settings(const std::vector<std::string>& settings) {
    std::set<std::string> names;
    for (const std::string& setting : settings) {
        const std::size_t equals = setting.find('=');
        if (equals == 0 || equals == std::string::npos)
            return fail(Exit::usage, "'" + setting + "' is not name=value");
        if (!names.insert(setting.substr(0, equals)).second)
            return fail(Exit::usage, "'" + setting.substr(0, equals) + "' is set twice");
    }
    return {};
}

}  // namespace

std::string exit_codes() {
    std::string text = "\nExit codes:\n";
    for (const protocol::ExitInfo& exit : protocol::exit_table()) {
        const std::string code = std::to_string(static_cast<int>(exit.code));
        text += "  " + code + std::string(5 - code.size(), ' ') + std::string(exit.text) + "\n";
    }
    return text;
}

void add_scene(CommandLine& line, std::string& scene) {
    line.add_option(
            "SCENE", scene,
            "name of a loaded scene (see: raynest scenes); or FILE.glb, FILE.obj, FILE.ply, "
            "builtin:NAME or root:PATH, which is loaded for this command")
        .required();
}

void add_epoch(CommandLine& line, std::uint64_t& epoch) {
    line.add_whole("--epoch", epoch, std::uint64_t{1}, any_whole,
                   "epoch of the scene (the current one)");
}

void add_deadline(CommandLine& line, double& deadline, const char* text) {
    line.add_number("--deadline", deadline, 0.001, 4.0e6,
                    "a number of seconds from 0.001 to 4000000", text);
}

void add_job(CommandLine& line, JobOptions& job) {
    add_scene(line, job.scene);
    line.add_option("--intersector", job.intersector,
                    "what decides whether a surface was hit (auto; see: raynest variants)");
    line.add_all(
            "--set",
            [&job](const std::vector<std::string>& settings) {
                job.settings = settings;
                return check_settings(settings);
            },
            "a parameter of the intersector; for a table VALUE is @FILE (.npy, or numbers as "
            "text); may be repeated")
        .type_name("NAME=VALUE");
    // An old option without effect; it has no group, so that help does not list it.
    line.add_parsed(
            "--precision",
            [](const std::string&) {
                return "no longer exists: the watertight test is always used";
            },
            "")
        .hidden();
    line.add_option("--traversal", job.traversal, alternatives(traversal_words));
    line.add_parsed(
        "--mask",
        [&job](const std::string& text) -> std::string {
            const auto mask = parse_mask(text);
            if (!mask) return mask.error().message;
            job.mask = *mask;
            return "";
        },
        "only instances with one of these bits, hexadecimal (FFFFFFFF)");
    add_epoch(line, job.epoch);
    line.add_option("--worker", job.worker, alternatives(worker_words));
    add_deadline(line, job.deadline, "give up after this many seconds");
    line.add_option("--priority", job.priority, "normal | low | high");
    line.add_each(
        "--hide",
        [&job](const std::string& text) -> Result<void> {
            job.hide.push_back(text);
            return check_selection(text);
        },
        "leave something out: a part at any depth by the text of its PATH, with * for any text, or "
        "inst=NUMBER, object=NUMBER or path=NUMBER as the columns of query have them; may be "
        "repeated");
    line.add_each(
        "--only",
        [&job](const std::string& text) -> Result<void> {
            job.only.push_back(text);
            return check_selection(text);
        },
        "leave out everything else; may be repeated");
    line.add_flag(
        "--skip-hidden-boxes", job.skip_hidden_boxes,
        "neither test nor count boxes that lead only to what --hide and --only leave out");
}

void add_animation(CommandLine& line, MomentOptions& moment) {
    line.add_option(
        "--animation", moment.animation,
        "name or number of an animation of the scene (the first one; see: raynest info)");
}

Option add_moment(CommandLine& line, MomentOptions& moment) {
    const Option time = line.add_parsed(
        "--time",
        [&moment](const std::string& text) -> std::string {
            const auto seconds = parse_world(text, 1, 1, "seconds");
            if (!seconds) return seconds.error().message;
            moment.time = seconds->front();
            return std::isfinite(*moment.time) ? "" : "'" + text + "' is not finite";
        },
        "the scene at this moment of its animation, in seconds");
    time.type_name("SECONDS");
    add_animation(line, moment);
    line.find("--animation").needs(time);
    return time;
}

void add_camera(CommandLine& line, CameraOptions& camera) {
    const Option name = line.add_option(
        "--camera", camera.name,
        "number or name of a camera of the scene (the first one; see: raynest info)");
    const Option look_at = line.add_parsed(
        "--lookat",
        [&camera](const std::string& text) -> std::string {
            const auto numbers = parse_world(text, 6, 9, "ex,ey,ez,ax,ay,az[,ux,uy,uz]");
            if (!numbers) return numbers.error().message;
            if (!std::all_of(numbers->begin(), numbers->end(),
                             [](double x) { return std::isfinite(x); }))
                return "'" + text + "' has a number that is not finite";
            camera.look_at = *numbers;
            return "";
        },
        "a camera of your own: eye, point looked at, up (the scene's)");
    name.excludes(look_at);
    line.add_number("--fov", camera.fov_degrees, 0.001F, 179.999F,
                    "a number of degrees from 0.001 to 179.999",
                    "vertical angle of view in degrees");
    line.add_parsed(
        "--size",
        [&camera](const std::string& text) -> std::string {
            const char* end = text.data() + text.size();
            const auto width = std::from_chars(text.data(), end, camera.width);
            const bool has_x = width.ptr != end && *width.ptr == 'x';
            if (width.ec == std::errc{} && has_x) {
                const auto height = std::from_chars(width.ptr + 1, end, camera.height);
                const protocol::Limits limits;
                const auto fits = [&](std::uint64_t side) {
                    return side > 0 && side <= limits.picture_side_max;
                };
                if (height.ec == std::errc{} && height.ptr == end && fits(camera.width) &&
                    fits(camera.height) &&
                    std::uint64_t{camera.width} * camera.height <= limits.picture_pixels_max)
                    return "";
            }
            const protocol::Limits limits;
            return "'" + text + "' is not WIDTHxHEIGHT, each from 1 to " +
                   std::to_string(limits.picture_side_max) + " and together at most " +
                   std::to_string(limits.picture_pixels_max) + " pixels";
        },
        "pixels, WIDTHxHEIGHT (960x540)");
}

Option add_output(CommandLine& line, std::string& output, const std::vector<std::string>& endings,
                  const std::string& text, bool to_stdout) {
    return line.add_parsed(
        "-o,--output",
        [&output, endings, to_stdout](const std::string& value) -> std::string {
            output = value;
            if (to_stdout && value == standard_stream) return "";
            if (is_device(value)) return "";
            std::string known;
            for (const std::string& ending : endings) {
                // An ending may have two dots: .rnscene.json.
                if (value.size() > ending.size() &&
                    std::equal(ending.rbegin(), ending.rend(), value.rbegin(),
                               [](char wanted, char given) {
                                   return wanted == std::tolower(static_cast<unsigned char>(given));
                               }))
                    return "";
                known += (known.empty() ? "" : " or ") + ending;
            }
            return "'" + value + "' must end in " + known +
                   (to_stdout ? ", or be - for stdout" : "");
        },
        to_stdout ? text + "; - for stdout, -" + endings[0] +
                        " to choose the format there; messages then go to stderr"
                  : text);
}

void add_kind(CommandLine& line, std::string& kind, std::uint32_t& max_hits,
              std::vector<std::string>& fields) {
    line.add_option("--kind", kind,
                    alternatives(kind_words) + " (canonical misses, nothing is traced)");
    constexpr protocol::Limits limits;
    line.add_whole("--max-hits", max_hits, 1U, static_cast<std::uint32_t>(limits.all_hits_max),
                   "most hits per ray: for kind multi (8, up to " +
                       std::to_string(limits.hits_max) +
                       "), and for kind all, which keeps the nearest (4096)");
    line.at_end([&kind, &max_hits]() -> std::string {
        if (max_hits != 0 && !has_splits(kind))
            return "--max-hits: belongs to --kind multi and --kind all";
        if (kind == "multi" && max_hits > protocol::Limits{}.hits_max)
            return "--max-hits: of --kind multi is at most " +
                   std::to_string(protocol::Limits{}.hits_max) + "; --kind all keeps more";
        return "";
    });
    line.add_parsed(
        "--fields",
        [&fields](const std::string& text) -> std::string {
            fields = split(text);
            std::set<std::string> seen;
            for (const std::string& field : fields) {
                if (field.empty()) return "'" + text + "' has an empty name between its commas";
                if (!seen.insert(field).second) return "'" + field + "' is named twice";
            }
            return "";
        },
        "columns, separated by commas, of " + known_fields() +
            "; of --generate lidar and sweep also ring, and of sweep and rolling_shutter time");
}

void add_detach(CommandLine& line, JobOptions& job, const std::string* required_output) {
    line.add_flag(
        "--detach", job.detach,
        "start the job, print its number and end; raynest fetch NUMBER -o FILE gets the answer. "
        "-o then only chooses the format");
    if (required_output == nullptr) return;
    line.at_end([&job, required_output] {
        return required_output->empty() && !job.detach ? "--output is required" : "";
    });
}

Option add_part(CommandLine& line, PartOption& part) {
    return line
        .add_parsed(
            "--part",
            [&part](const std::string& text) -> std::string {
                const char* const end = text.data() + text.size();
                const auto [slash, bad] = std::from_chars(text.data(), end, part.number);
                if (bad == std::errc{} && slash != end && *slash == '/') {
                    const auto [last, wrong] = std::from_chars(slash + 1, end, part.count);
                    if (wrong == std::errc{} && last == end && part.number >= 1 &&
                        part.number <= part.count && part.count <= part_count_max)
                        return "";
                }
                return "'" + text + "' is not I/N, such as 3/8, with I from 1 to N";
            },
            "I/N: make part I of N alone, on one of N machines; `raynest merge` joins the files")
        .type_name("I/N");
}

void add_progressive(CommandLine& line, bool& progressive) {
    line.add_flag("--progressive", progressive,
                  "write the whole picture after each pass: with 1, 2, 4, ... samples");
}

void add_environment(CommandLine& line, std::string& environment) {
    line.add_option("--env", environment,
                    "what lights from afar: sky | none | auto (sky, unless the file has lights) | "
                    "FILE.exr or FILE.hdr, a picture all around whose middle lies at +X");
}

void add_light(CommandLine& line, LightOptions& light, const std::string& integrators) {
    line.add_option("--integrator", light.integrator, integrators);
    line.add_whole("--seed", light.seed, std::uint64_t{0}, any_whole,
                   "seed of the random numbers (0)");
    each_setting(
        [&line](const SettingWords& setting, auto& value) {
            using Number = std::remove_reference_t<decltype(value)>;
            line.add_number(std::string(setting.option), value, static_cast<Number>(setting.least),
                            static_cast<Number>(setting.most), std::string(setting.range),
                            for_integrators(setting.name) + std::string(setting.text) + " (" +
                                std::string(setting.otherwise) + ")");
        },
        light);
    add_environment(line, light.environment);
    line.add_parsed(
            "--sun",
            [&light](const std::string& text) -> std::string {
                const auto numbers = parse_world(text, 2, 2, "azimuth,elevation");
                if (!numbers) return numbers.error().message;
                const double azimuth = (*numbers)[0];
                const double elevation = (*numbers)[1];
                if (!(std::abs(azimuth) <= 360 && std::abs(elevation) <= 90))
                    return "'" + text +
                           "' is not an azimuth within 360 and an elevation within 90 "
                           "degrees";
                light.sun = {static_cast<float>(azimuth), static_cast<float>(elevation)};
                return "";
            },
            "the sky's sun: degrees from north (-Z, or +Y in a scene with +Z up) eastwards, and "
            "degrees above the horizon")
        .type_name("AZIMUTH,ELEVATION");
}

void add_job_number(CommandLine& line, std::uint64_t& job) {
    line.add_whole("ID", job, std::uint64_t{1}, any_whole, "number of a job (see: raynest jobs)")
        .required();
}

Option add_point(CommandLine& line, const std::string& name, const std::string& text,
                 std::function<void(const WorldPoint&)> take) {
    const auto read = [take = std::move(take)](const std::string& value) -> std::string {
        const auto numbers = parse_world(value, 3, 3, "x,y,z");
        if (!numbers) return numbers.error().message;
        take(WorldPoint{(*numbers)[0], (*numbers)[1], (*numbers)[2]});
        return "";
    };
    return line.add_parsed(name, read, text).type_name("X,Y,Z");
}

void add_film(CommandLine& line, RenderOptions& render) {
    constexpr protocol::Limits limits;
    std::string integrators =
        "primary (base colour, darker where it turns away; one ray per pixel)";
    std::string unlit;
    for (const IntegratorWords& each : integrator_words) {
        integrators.append(" | ").append(each.name).append(" (").append(each.text).append(")");
        if (!each.lit) unlit.append(unlit.empty() ? "; for " : ", ").append(each.name);
    }
    add_light(line, render, integrators);
    line.add_whole("--spp,--samples", render.samples, 1U,
                   static_cast<std::uint32_t>(limits.samples_max),
                   "samples per pixel (16, with --noise 1024; primary has 1)");
    line.add_option("--tonemap", render.tonemap,
                    "for all but .exr: " + alternatives(tonemap_words) + " (agx" +
                        (unlit.empty() ? "" : unlit + " none") + ")");
    line.add_option(
        "--exposure", render.exposure,
        "for all but .exr: stops, or auto (auto" + (unlit.empty() ? "" : unlit + " 0") + ")");
    line.add_number("--env-rotate", render.environment_rotate, -360.0F, 360.0F,
                    "a number of degrees from -360 to 360",
                    "turns the picture of --env by this angle from north eastwards (0)");
    line.add_number("--noise", render.noise, 1e-6F, 1.0F, "a number from 0.000001 to 1",
                    "end parts of the picture when their error, as a share of their brightness, is "
                    "below this; --spp is then the most");
}

void add_generate(CommandLine& line, std::vector<std::string>& generate, const std::string& text) {
    line.add_words(
        "--generate",
        [&generate](const std::vector<std::string>& words) -> Result<void> {
            if (const auto parsed = parse_generate(words); !parsed)
                return tl::unexpected<Failure>(parsed.error());
            generate = words;
            return {};
        },
        text);
}

}  // namespace raynest::client
