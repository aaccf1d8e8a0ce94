// The options that several commands share, as CLI11 declares them. Included by options.cpp alone:
// the header of CLI11 is large.
#pragma once

#include "client/commands/parse.h"
#include "client/files/files.h"
#include "client/ground/lists.h"
#include "client/ground/numbers.h"
#include "client/requests/request_options.h"
#include "protocol/limits.h"

#include <CLI/CLI.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// Returns the exit codes as help lists them.
inline std::string exit_codes() {
    std::string text = "\nExit codes:\n";
    for (const protocol::ExitInfo& exit : protocol::exit_table()) {
        const std::string code = std::to_string(static_cast<int>(exit.code));
        text += "  " + code + std::string(5 - code.size(), ' ') + std::string(exit.text) + "\n";
    }
    return text;
}

/// Adds an option whose text is parsed by `read`, which returns what is wrong, or "".
template <class Read>
CLI::Option* add_parsed(CLI::App& app, const std::string& name, Read read,
                        const std::string& text) {
    return app.add_option_function<std::string>(
        name,
        [name, read](const std::string& value) {
            const std::string complaint = read(value);
            if (!complaint.empty()) throw CLI::ValidationError(name, complaint);
        },
        text);
}

/// Adds an option that may be repeated; `read` takes each text and fails with what is wrong.
template <class Read>
void add_each(CLI::App& app, const std::string& name, Read read, const std::string& text) {
    app.add_option_function<std::vector<std::string>>(
           name,
           [name, read](const std::vector<std::string>& values) {
               for (const std::string& value : values)
                   if (const auto taken = read(value); !taken)
                       throw CLI::ValidationError(name, taken.error().message);
           },
           text)
        ->take_all()
        ->allow_extra_args(false);
}

/// Adds a number from `least` to `most`; `what` is the text for messages. CLI11's own parser would
/// read -1 and 2^70 as 2^64 - 1, and its ranges accept NaN.
template <class Number>
CLI::Option* add_number(CLI::App& app, const std::string& name, Number& value, Number least,
                        Number most, const std::string& what, const std::string& text) {
    const auto read = [&value, least, most, what](const std::string& digits) -> std::string {
        const char* last = digits.data() + digits.size();
        const auto [end, error] = std::from_chars(digits.data(), last, value);
        const bool good = error == std::errc{} && end == last && value >= least && value <= most;
        return good ? "" : "'" + digits + "' is not " + what;
    };
    const bool is_bounded = most != std::numeric_limits<Number>::max();
    const std::string range = is_bounded ? ", " + what.substr(what.find("from ")) : "";
    return add_parsed(app, name, read, text + range)->type_name("NUMBER");
}

template <class Whole>
CLI::Option* add_whole(CLI::App& app, const std::string& name, Whole& value, Whole least,
                       Whole most, const std::string& text) {
    return add_number(
        app, name, value, least, most,
        "a whole number from " + std::to_string(least) + " to " + std::to_string(most), text);
}
inline constexpr std::uint64_t any_whole = std::numeric_limits<std::uint64_t>::max();

/// Says in words what CLI11 says of an option group: "Exactly 1 option from [--ray,--rays] is
/// required", of two "but 2 were given" too.
inline std::string plain_words(std::string what) {
    constexpr std::string_view begin = "Exactly 1 option from [";
    const std::size_t end = what.find(']');
    if (!what.starts_with(begin) || end == std::string::npos) return what;
    std::string names = what.substr(begin.size(), end - begin.size());
    for (std::size_t at = 0; (at = names.find(',', at)) != std::string::npos; at += 2)
        names.insert(at + 1, " ");
    return "one of " + names + what.substr(end + 1);
}

/// Refuses "", which a script passes for a variable that it forgot to set.
inline std::string complain_if_empty(const std::string& text) {
    return text.empty() ? "must not be empty" : "";
}

/// Checks that all are name=value, each name once.
inline void check_settings(const std::vector<std::string>& settings) {
    std::set<std::string> names;
    for (const std::string& setting : settings) {
        const std::size_t equals = setting.find('=');
        if (equals == 0 || equals == std::string::npos)
            throw CLI::ValidationError("--set", "'" + setting + "' is not name=value");
        if (!names.insert(setting.substr(0, equals)).second)
            throw CLI::ValidationError("--set", "'" + setting.substr(0, equals) + "' is set twice");
    }
}

inline void add_scene(CLI::App& app, std::string& scene) {
    app.add_option("SCENE", scene,
                   "name of a loaded scene (see: raynest scenes); or FILE.glb, FILE.gltf, "
                   "builtin:NAME or root:PATH, which is loaded for this command")
        ->required();
}

inline void add_epoch(CLI::App& app, std::uint64_t& epoch) {
    add_whole(app, "--epoch", epoch, std::uint64_t{1}, any_whole,
              "epoch of the scene (the current one)");
}

inline void add_deadline(CLI::App& app, double& deadline, const char* text) {
    add_number(app, "--deadline", deadline, 0.001, 4.0e6,
               "a number of seconds from 0.001 to 4000000", text);
}

inline void add_job(CLI::App& app, JobOptions& job) {
    add_scene(app, job.scene);
    app.add_option("--intersector", job.intersector,
                   "what decides whether a surface was hit (auto; see: raynest variants)");
    app.add_option_function<std::vector<std::string>>(
           "--set",
           [&job](const std::vector<std::string>& settings) {
               check_settings(settings);
               job.settings = settings;
           },
           "a parameter of the intersector, @FILE of one that is a table (.npy, or numbers as "
           "text); may be repeated")
        ->type_name("NAME=VALUE")
        ->take_all()
        ->allow_extra_args(false);
    // An old option without effect; it has no group, so that help does not list it.
    add_parsed(
        app, "--precision",
        [](const std::string&) { return "no longer exists: the watertight test is always used"; },
        "")
        ->group("");
    app.add_option("--traversal", job.traversal, alternatives(traversal_words));
    add_parsed(
        app, "--mask",
        [&job](const std::string& text) -> std::string {
            const auto mask = parse_mask(text);
            if (!mask) return mask.error().message;
            job.mask = *mask;
            return "";
        },
        "only instances with one of these bits, hexadecimal (FFFFFFFF)");
    add_epoch(app, job.epoch);
    app.add_option("--worker", job.worker, alternatives(worker_words));
    add_deadline(app, job.deadline, "give up after this many seconds");
    app.add_option("--priority", job.priority, "normal | low | high");
    add_each(
        app, "--hide",
        [&job](const std::string& text) -> Result<void> {
            job.hide.push_back(text);
            return check_selection(text);
        },
        "leave something out: the outermost instance of a PATH's text, inst=NUMBER or "
        "object=NUMBER as the columns of query have them; may be repeated");
    add_each(
        app, "--only",
        [&job](const std::string& text) -> Result<void> {
            job.only.push_back(text);
            return check_selection(text);
        },
        "leave out all else; may be repeated");
    app.add_flag("--skip-hidden-boxes", job.skip_hidden_boxes,
                 "leave boxes out of tests and counts that lead to nothing but what --hide and --only "
                 "leave out");
}

inline void add_camera(CLI::App& app, CameraOptions& camera) {
    CLI::Option* name = app.add_option(
        "--camera", camera.name,
        "number or name of a camera of the scene (the first one; see: raynest info)");
    CLI::Option* look_at = add_parsed(
        app, "--lookat",
        [&camera](const std::string& text) -> std::string {
            const auto numbers = parse_world(text, 6, 9, "ex,ey,ez,ax,ay,az[,ux,uy,uz]");
            if (!numbers) return numbers.error().message;
            if (!std::all_of(numbers->begin(), numbers->end(),
                             [](double x) { return std::isfinite(x); }))
                return "'" + text + "' has a number that is not finite";
            camera.look_at = *numbers;
            return "";
        },
        "a camera of your own: eye, point looked at, up (0,1,0)");
    name->excludes(look_at);
    add_number(app, "--fov", camera.fov_degrees, 0.001F, 179.999F,
               "a number of degrees from 0.001 to 179.999", "vertical angle of view in degrees");
    add_parsed(
        app, "--size",
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

/// Adds -o FILE with one of these endings, in small or capital letters, or "-" for stdout.
inline CLI::Option* add_output(CLI::App& app, std::string& output,
                               const std::vector<std::string>& endings, const std::string& text) {
    return add_parsed(
        app, "-o,--output",
        [&output, endings](const std::string& value) -> std::string {
            output = value;
            if (value == standard_stream) return "";
            if (is_device(value)) return "";
            std::string known;
            for (const std::string& ending : endings) {
                if (value.size() > ending.size() && extension_of(value) == ending) return "";
                known += (known.empty() ? "" : " or ") + ending;
            }
            return "'" + value + "' must end in " + known + ", or be - for stdout";
        },
        text + "; - for stdout, -" + endings[0] +
            " to choose the format there; messages then go to stderr");
}

/// Adds --kind, --max-hits and --fields. Uses the one callback that CLI11 has per command.
inline void add_kind(CLI::App& app, std::string& kind, std::uint32_t& max_hits,
                     std::vector<std::string>& fields) {
    app.add_option("--kind", kind,
                   alternatives(kind_words) + " (canonical misses, nothing is traced)");
    constexpr protocol::Limits limits;
    add_whole(app, "--max-hits", max_hits, 1U, static_cast<std::uint32_t>(limits.all_hits_max),
              "hits per ray: of kind multi (8, at most " + std::to_string(limits.hits_max) +
                  "), and of kind all, which keeps the nearest (4096)");
    app.parse_complete_callback([&kind, &max_hits] {
        if (max_hits != 0 && !has_splits(kind))
            throw CLI::ValidationError("--max-hits", "belongs to --kind multi and --kind all");
        if (kind == "multi" && max_hits > protocol::Limits{}.hits_max)
            throw CLI::ValidationError("--max-hits",
                                       "of --kind multi is at most " +
                                           std::to_string(protocol::Limits{}.hits_max) +
                                           "; --kind all keeps more");
    });
    add_parsed(
        app, "--fields",
        [&fields](const std::string& text) -> std::string {
            fields = split(text);
            std::set<std::string> seen;
            for (const std::string& field : fields) {
                if (field.empty()) return "'" + text + "' has an empty name between its commas";
                if (!seen.insert(field).second) return "'" + field + "' is named twice";
            }
            return "";
        },
        "columns, separated by commas, of " + known_fields());
}

/// Adds --detach, with which a file that is otherwise required may be left out. In that case it
/// uses the one callback that CLI11 has per command.
inline void add_detach(CLI::App& app, JobOptions& job, const std::string* required_output) {
    app.add_flag(
        "--detach", job.detach,
        "start the job, print its number and end; raynest fetch NUMBER -o FILE gets the answer. "
        "-o then only chooses the format");
    if (required_output == nullptr) return;
    app.parse_complete_callback([&job, required_output] {
        if (required_output->empty() && !job.detach) throw CLI::RequiredError("--output");
    });
}

template <class Take>
CLI::Option* add_point(CLI::App& app, const std::string& name, const std::string& text, Take take) {
    const auto read = [take](const std::string& value) -> std::string {
        const auto numbers = parse_world(value, 3, 3, "x,y,z");
        if (!numbers) return numbers.error().message;
        take(WorldPoint{(*numbers)[0], (*numbers)[1], (*numbers)[2]});
        return "";
    };
    return add_parsed(app, name, read, text)->type_name("X,Y,Z");
}

}  // namespace raynest::client
