#include "client/requests/film.h"

#include "client/files/exr_header.h"
#include "client/files/files.h"
#include "client/ground/lists.h"
#include "client/ground/numbers.h"
#include "client/requests/send_file.h"

#include <charconv>
#include <map>
#include <span>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

constexpr std::uint32_t lit_samples = 16;
/// Most samples of a picture that ends where its error is small enough.
constexpr std::uint32_t noise_samples = 1024;
constexpr std::uint64_t environment_bytes_max = 512ULL << 20;
/// Time for encoding and sending, after which a daemon that is late counts as lost.
constexpr std::chrono::minutes grace{10};

bool is_lit(const std::string& integrator) {
    return !integrator.empty() && integrator != "primary";
}

/// Sets the environment of a request: a word, or a file that is read.
Result<void> set_environment(const std::string& environment, wire::RenderT& request,
                             FilmFiles& files) {
    request.environment = environment;
    if (environment.empty() || environment == "sky" || environment == "none" ||
        environment == "auto")
        return {};
    auto bytes = read_file(environment, environment_bytes_max);
    if (!bytes) return tl::unexpected<Failure>(bytes.error());
    if (bytes->size() == 0) return fail(Exit::invalid, environment + " is empty");
    const auto held = std::as_const(*bytes).span();
    const std::string_view text(reinterpret_cast<const char*>(held.data()), held.size());
    if (!text.starts_with("\x76\x2f\x31\x01") && !text.starts_with("#?RADIANCE") &&
        !text.starts_with("#?RGBE"))
        return fail(Exit::usage, environment +
                                     " is neither an EXR nor an HDR: --env takes pictures "
                                     "with the range of light; convert it to one of them");
    files.environment_name = environment;
    files.environment = std::move(*bytes);
    request.environment = "picture";
    request.environment_bytes = files.environment.size();
    return {};
}

/// The texts of an EXR's header, which say what was asked for.
struct FilmFile {
    std::map<std::string, std::string> texts;

    /// The value of an attribute of ours; "" where there is none.
    [[nodiscard]] std::string value(std::string_view name) const {
        const auto found = texts.find("raynest:" + std::string(name));
        return found == texts.end() ? "" : found->second;
    }
};

Result<FilmFile> read_film_file(std::span<const std::byte> bytes, const std::string& name) {
    auto texts = read_exr_texts(bytes);
    if (!texts) return fail(Exit::invalid, name + ": " + texts.error().message);
    FilmFile film{std::move(*texts)};
    if (is_lit(film.value("integrator"))) return film;
    return fail(Exit::invalid, name +
                                   ": is no lit picture of raynest: make one with raynest render "
                                   "SCENE --integrator path -o FILE.exr");
}

/// Reads a number of an EXR's header.
template <class Number>
Result<void> read_number(const FilmFile& film, std::string_view name, Number& value,
                         const std::string& file) {
    const std::string text = film.value(name);
    const char* const end = text.data() + text.size();
    const auto [last, error] = std::from_chars(text.data(), end, value);
    if (error == std::errc{} && last == end) return {};
    return fail(Exit::invalid, file + " has no valid " + std::string(name) + " in its header");
}

/// Reads the camera of an EXR's header: "first", "name NAME" or "lookat" and six or nine
/// numbers.
Result<std::unique_ptr<wire::CameraT>> read_camera(const FilmFile& film, const std::string& file) {
    auto camera = std::make_unique<wire::CameraT>();
    if (auto read = read_number(film, "fov", camera->fov_degrees, file); !read)
        return tl::unexpected<Failure>(read.error());
    const std::string asked = film.value("camera_asked");
    if (asked.starts_with("name ")) {
        camera->name = asked.substr(5);
    } else if (asked.starts_with("lookat ")) {
        std::string numbers = asked.substr(7);
        for (char& letter : numbers)
            if (letter == ' ') letter = ',';
        const auto parsed = parse_world(numbers, 6, 9, "nine numbers");
        if (!parsed) return fail(Exit::invalid, file + " has no valid camera in its header");
        const auto vector = [&](std::size_t at) {
            const auto number = [&](std::size_t i) {
                return static_cast<float>((*parsed)[at + i]);
            };
            return std::make_unique<wire::Vec3>(number(0), number(1), number(2));
        };
        camera->look_at = true;
        camera->eye = vector(0);
        camera->at = vector(3);
        if (parsed->size() == 9) camera->up = vector(6);
    } else if (asked != "first") {
        return fail(Exit::invalid, file + " has no valid camera in its header");
    }
    return camera;
}

/// A space within a text of a path is %20 in the header of a film.
std::string with_spaces(std::string text) {
    for (std::size_t at = 0; (at = text.find("%20", at)) != std::string::npos; ++at)
        text.replace(at, 3, " ");
    return text;
}

}  // namespace

void set_light(const LightOptions& options, wire::RenderT& request) {
    request.integrator = options.integrator;
    request.seed = options.seed;
    each_setting([](const SettingWords&, auto& to, auto from) { to = from; }, request, options);
    request.environment = options.environment;
    if (!options.sun) return;
    request.sun = true;
    request.sun_azimuth = (*options.sun)[0];
    request.sun_elevation = (*options.sun)[1];
}

std::uint32_t samples_of(const RenderOptions& options) {
    if (options.samples != 0) return options.samples;
    if (!is_lit(options.integrator)) return 1;
    return options.noise > 0 ? noise_samples : lit_samples;
}

Result<void> fill_film(const RenderOptions& options, wire::RenderT& request, FilmFiles& files) {
    const bool lit = is_lit(options.integrator);
    set_light(options, request);
    request.samples = samples_of(options);
    request.tonemap = options.tonemap;
    request.exposure = options.exposure;
    request.progressive = options.progressive;
    request.noise = options.noise;
    request.environment_rotate = options.environment_rotate;
    if (lit && request.job->deadline_ms != 0)
        request.best_by_ms = std::exchange(request.job->deadline_ms, 0);
    return set_environment(options.environment, request, files);
}

Result<wire::RenderT> resumed_film(const ResumeOptions& options, FilmFiles& files) {
    auto bytes = read_file(options.file, protocol::Limits{}.upload_bytes_max);
    if (!bytes) return tl::unexpected<Failure>(bytes.error());
    files.resumed = std::move(*bytes);
    const auto film = read_film_file(files.resumed.span(), options.file);
    if (!film) return tl::unexpected<Failure>(film.error());

    wire::RenderT request;
    request.job = std::make_unique<wire::JobT>();
    request.job->scene = options.scene.empty() ? film->value("scene") : options.scene;
    request.job->intersector = film->value("intersector");
    if (const std::string set = film->value("set"); set != "none")
        for (const std::string& setting : split(set, ' ')) request.job->settings.push_back(setting);
    JobOptions selected;
    for (auto [name, list] : {std::pair("hide", &selected.hide), std::pair("only", &selected.only)})
        if (const std::string texts = film->value(name); !texts.empty())
            for (const std::string& text : split(texts, ' ')) list->push_back(with_spaces(text));
    add_selection(selected, *request.job);
    request.best_by_ms = static_cast<std::uint32_t>(deadline_of(options.deadline).count());
    request.integrator = film->value("integrator");
    request.encode = "exr";
    request.samples = options.samples;
    request.progressive = options.progressive;
    request.resume_bytes = files.resumed.size();
    Result<void> read = read_number(*film, "width", request.width, options.file);
    if (read) read = read_number(*film, "height", request.height, options.file);
    if (read) read = read_number(*film, "mask", request.job->mask, options.file);
    if (read) read = read_number(*film, "seed", request.seed, options.file);
    each_setting(
        [&](const SettingWords& setting, auto& value) {
            if (read) read = read_number(*film, setting.name, value, options.file);
        },
        request);
    if (read) read = read_number(*film, "noise", request.noise, options.file);
    if (!read) return tl::unexpected<Failure>(read.error());
    if (const std::string sun = film->value("sun"); sun != "auto") {
        const auto numbers = parse_world(sun, 2, 2, "azimuth,elevation");
        if (!numbers) return fail(Exit::invalid, options.file + " has no valid sun in its header");
        request.sun = true;
        request.sun_azimuth = static_cast<float>((*numbers)[0]);
        request.sun_elevation = static_cast<float>((*numbers)[1]);
    }
    if (film->value("environment") == "picture")
        if (read =
                read_number(*film, "environment_rotate", request.environment_rotate, options.file);
            !read)
            return tl::unexpected<Failure>(read.error());
    auto camera = read_camera(*film, options.file);
    if (!camera) return tl::unexpected<Failure>(camera.error());
    request.camera = std::move(*camera);

    std::string environment = film->value("environment");
    const std::string& asked = options.environment;
    if (environment == "picture")
        environment = asked;
    else if (!environment.empty() && !asked.empty() && asked != environment)
        return fail(Exit::usage, options.file + " was lit with --env " + environment + ", not " +
                                     asked + ": leave --env out");
    if (environment.empty())
        return fail(Exit::usage, options.file + " was lit by a picture: pass it with --env");
    if (auto set = set_environment(environment, request, files); !set)
        return tl::unexpected<Failure>(set.error());
    return request;
}

namespace {

/// Names the file in what the daemon says of "the environment".
Failure with_name(Failure failure, const FilmFiles& files) {
    constexpr std::string_view subject = "the environment";
    if (!files.environment_name.empty() && failure.message.starts_with(subject))
        failure.message.insert(subject.size(), " " + files.environment_name);
    return failure;
}

}  // namespace

Result<ReceivedFile> run_film(Connection& connection, Progress& progress,
                              const wire::RenderT& request, const FilmFiles& files,
                              const PassConsumer& consume_pass) {
    // A lit picture that is late comes all the same: allow for encoding it.
    std::chrono::milliseconds deadline(request.job->deadline_ms);
    if (request.best_by_ms != 0) deadline = std::chrono::milliseconds(request.best_by_ms) + grace;
    if (auto started = connection.start(request, deadline); !started)
        return tl::unexpected<Failure>(started.error());
    ReceivedFile picture;
    picture.outcome.may_detach = request.job->detach;
    const FrameConsumer consume = [&](const protocol::Frame& frame) {
        return take_news(frame, picture.outcome);
    };
    std::uint32_t number = 0;
    for (const protocol::Buffer* file : {&files.resumed, &files.environment})
        if (auto sent = send_file(connection, number++, file->span(), progress, consume); !sent)
            return tl::unexpected<Failure>(with_name(sent.error(), files));
    auto received =
        receive_file(connection, progress, room_of(request), std::move(picture), consume_pass);
    if (!received) return tl::unexpected<Failure>(with_name(received.error(), files));
    return received;
}

Result<ReceivedFile> ask_film(Connection& connection, Progress& progress,
                              const PictureOptions& options, wire::RenderT request,
                              const FilmFiles& files, const PassConsumer& consume_pass) {
    return with_camera(connection, progress, options, request, [&] {
        return run_film(connection, progress, request, files, consume_pass);
    });
}

}  // namespace raynest::client
