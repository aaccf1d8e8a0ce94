// raynest animate SCENE -o FILM.mp4: pictures of the moments of an animation, as files or a film.
#include "client/arguments/shared_options.h"
#include "client/commands/deliver.h"
#include "client/files/files.h"
#include "client/ground/child_process.h"
#include "client/ground/lists.h"
#include "client/output/output.h"
#include "client/output/output_file.h"
#include "client/requests/film.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

struct AnimateOptions : RenderOptions {
    double fps = 25;
    double from = 0;  ///< seconds
    double to = -1;   ///< negative: the animation's end
};

namespace fs = std::filesystem;

constexpr const char* film_ending = ".mp4";
constexpr std::size_t frames_max = 100'000;

bool is_film(const std::string& output) {
    return extension_of(output) == film_ending;
}

/// A folder for frames that goes away at the end.
class Folder {
public:
    static Result<Folder> make() {
        std::error_code error;
        const fs::path parent = fs::temp_directory_path(error);
        std::string name = (parent / "raynest-frames-XXXXXX").string();
        if (error || ::mkdtemp(name.data()) == nullptr)
            return fail(Exit::failed, "there is no folder for temporary files: set TMPDIR");
        return Folder(name);
    }
    Folder(Folder&& other) noexcept : path_(std::exchange(other.path_, {})) {}
    Folder& operator=(Folder&&) = delete;
    ~Folder() {
        std::error_code ignored;
        if (!path_.empty()) fs::remove_all(path_, ignored);
    }
    [[nodiscard]] const fs::path& path() const { return path_; }

private:
    explicit Folder(fs::path path) : path_(std::move(path)) {}
    fs::path path_;
};

/// Runs a program to its end.
Result<void> run_program(const std::vector<std::string>& words) {
    auto child = ChildProcess::start(words, ChildKind::silent);
    if (!child)
        return fail(Exit::failed,
                    "a film needs ffmpeg (" + child.error().message +
                        "): apt install ffmpeg, or write pictures with -o FRAMES.png");
    int status = 0;
    while (!child->has_ended(&status)) std::this_thread::sleep_for(look_time);
    if (status == 0) return {};
    return fail(Exit::failed, "ffmpeg failed: " + child->last_line());
}

/// Returns "out.0007.png" of "out.png".
std::string frame_name(const std::string& output, std::size_t frame) {
    constexpr std::size_t digits_min = 4;
    const std::string number = std::to_string(frame);
    const std::size_t dot = output.size() - extension_of(output).size();
    return output.substr(0, dot) + "." +
           std::string(digits_min - std::min(digits_min, number.size()), '0') + number +
           output.substr(dot);
}

/// Returns how long the animation is.
Result<double> seconds_of(Context& context, const JobOptions& job) {
    wire::InfoT info;
    info.scene = job.scene;
    const auto described = ask<wire::SceneInfo>(context.connection, info);
    if (!described) return tl::unexpected<Failure>(described.error());
    const std::vector<std::string> names = protocol::strings((*described)->animations());
    const auto* seconds = (*described)->animation_seconds();
    if (names.empty())
        return fail(Exit::invalid, "the scene has no animation: `raynest edit` moves its parts");
    std::size_t at = 0;
    if (!job.animation.empty()) {
        const auto named = std::ranges::find(names, job.animation);
        at = static_cast<std::size_t>(named - names.begin());
        for (std::size_t i = 0; named == names.end() && i < names.size(); ++i)
            if (std::to_string(i) == job.animation) at = i;
    }
    if (at >= names.size())
        return fail(Exit::invalid, "the scene has no animation '" + job.animation +
                                       "': raynest info " + job.scene + " lists them");
    return seconds->Get(static_cast<flatbuffers::uoffset_t>(at));
}

/// Asks for one picture, in another encoding than its file has where that is named.
Result<ReceivedFile> ask_one(Context& context, const RenderOptions& options,
                             const char* encode = nullptr) {
    auto request = picture_request<wire::RenderT>(options);
    if (!request) return tl::unexpected<Failure>(request.error());
    FilmFiles files;
    if (auto filled = fill_film(options, *request, files); !filled)
        return tl::unexpected<Failure>(filled.error());
    if (encode != nullptr) request->encode = encode;
    Progress quiet(Progress::Style::none);  // there is one bar, of all pictures
    return ask_film(context.connection, quiet, options, *request, files, {});
}

/// Gives all pictures the exposure that the first one would have: a film must not flicker.
Result<void> fix_exposure(Context& context, RenderOptions& options) {
    const IntegratorWords* const by = find_integrator(options.integrator);
    if (by == nullptr || !by->lit || (!options.exposure.empty() && options.exposure != "auto"))
        return {};
    const auto picture = ask_one(context, options, "linear");
    if (!picture) return tl::unexpected<Failure>(picture.error());
    options.exposure = Json(picture->exposure).dump();
    return {};
}

}  // namespace

void declare(CommandLine& line, AnimateOptions& animate) {
    add_job(line, animate.job);
    add_animation(line, animate.job);
    add_camera(line, animate.camera);
    add_output(line, animate.output, {".mp4", ".png", ".exr"},
               "FILM.mp4 (by ffmpeg), or FRAMES.png or .exr: FRAMES.0000.png and so on", false)
        .required();
    add_film(line, animate);
    line.add_number("--fps", animate.fps, 0.001, 1000.0, "a number from 0.001 to 1000",
                    "pictures per second (25)");
    line.add_number("--from", animate.from, 0.0, 1e6, "a number from 0 to 1000000",
                    "the first moment, in seconds (0)");
    line.add_number("--to", animate.to, 0.0, 1e6, "a number from 0 to 1000000",
                    "the last moment, in seconds (the animation's end)");
}

Result<void> run(Context& context, const AnimateOptions& options) {
    if (is_stdout(options.output))
        return fail(Exit::usage, "animate writes a film or several files: name them with -o");
    const bool film = is_film(options.output);
    if (auto writable = check_writable(options.output); !writable) return writable;
    if (film)
        if (auto there = run_program({"ffmpeg", "-version"}); !there) return there;
    const auto length = seconds_of(context, options.job);
    if (!length) return tl::unexpected<Failure>(length.error());
    const double to = options.to < 0 ? *length : options.to;
    if (to > *length || options.from > to)
        return fail(Exit::usage, "the animation runs from 0 to " + Json(*length).dump() +
                                     " s: --from and --to must lie there, in this order");
    const double count = std::floor((to - options.from) * options.fps + 1e-9) + 1;
    if (count > static_cast<double>(frames_max))
        return fail(Exit::usage, "these are more than " + std::to_string(frames_max) +
                                     " pictures: lower --fps, or set --from and --to");
    std::optional<Folder> folder;
    if (film) {
        auto made = Folder::make();
        if (!made) return tl::unexpected<Failure>(made.error());
        folder.emplace(std::move(*made));
    }
    const std::string frames = film ? (folder->path() / "frame.png").string() : options.output;
    RenderOptions one = options;
    one.output = frames;
    one.job.time = options.from;
    if (auto fixed = fix_exposure(context, one); !fixed) return fixed;
    for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i) {
        one.job.time = options.from + static_cast<double>(i) / options.fps;
        context.progress.update(i, static_cast<std::uint64_t>(count), "pictures");
        const auto picture = ask_one(context, one);
        if (!picture) return tl::unexpected<Failure>(picture.error());
        if (auto written = write_picture(frame_name(frames, i), *picture); !written) return written;
    }
    if (film) {
        context.progress.update(0, 0, "writing the film");
        // Sides of an odd number of pixels get one more: most players want them even.
        auto done = run_program({"ffmpeg", "-nostdin", "-y", "-v", "error", "-framerate",
                                 Json(options.fps).dump(), "-i",
                                 (folder->path() / "frame.%04d.png").string(), "-vf",
                                 "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p",
                                 "-movflags", "+faststart", options.output});
        if (!done) return done;
    }
    context.progress.clear();
    const auto pictures = static_cast<std::size_t>(count);
    if (context.json)
        print_json({{"output", options.output},
                    {"pictures", pictures},
                    {"from", options.from},
                    {"fps", options.fps}},
                   summary_of(options.output));
    else
        summary_of(options.output)
            << options.output << ": " << pictures << (pictures == 1 ? " picture" : " pictures")
            << ", " << options.fps << " per second\n";
    return {};
}

std::unique_ptr<Command> make_animate() {
    return make_command<AnimateOptions>();
}

}  // namespace raynest::client
