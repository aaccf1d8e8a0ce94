#include "server/requests/words/film_options.h"

#include "protocol/text.h"
#include "server/documents/plan_text.h"
#include "server/documents/selection_text.h"
#include "server/jobs/films/film_tiles.h"
#include "server/jobs/films/received_picture.h"
#include "server/jobs/picture_job.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace raynest::server {
namespace {

/// Largest file with a picture of the surroundings.
constexpr std::uint64_t environment_bytes_max = 512ULL << 20;

Reply<IntegratorSettings> integrator_settings(const RenderWords& words) {
    using Environment = IntegratorSettings::Environment;
    constexpr std::array<std::pair<std::string_view, Environment>, 4> environments = {
        {{"auto", Environment::automatic},
         {"sky", Environment::sky},
         {"none", Environment::none},
         {"picture", Environment::picture}}};
    IntegratorSettings settings;
#define RAYNEST_INTEGRATOR_SETTING(name, type, option, label, least, most, ...)                \
    if (words.name != 0 &&                                                                     \
        !(words.name >= static_cast<type>(least) && words.name <= static_cast<type>(most)))    \
        return refuse(Code::invalid_field, "`" #name "` is " + number_text(words.name) +       \
                                               ": it must lie between " #least " and " #most); \
    if (words.name != 0) settings.name = words.name;
#include "engine/integrators/integrator_settings.def"
    const std::string_view word = words.environment;
    const auto* const chosen =
        std::ranges::find(environments, word, &std::pair<std::string_view, Environment>::first);
    if (chosen == environments.end())
        return refuse(Code::invalid_field, "unknown environment '" + std::string(word) +
                                               "': use one of auto, sky, none, picture");
    settings.environment = chosen->second;
    if ((settings.environment == Environment::picture) != (words.environment_bytes != 0))
        return refuse(Code::invalid_field,
                      "environment picture comes with a file, and only that: say its size in "
                      "environment_bytes");
    if (words.environment_bytes > environment_bytes_max)
        return refuse(Code::limit_exceeded,
                      "the environment's file has " +
                          protocol::bytes_text(words.environment_bytes) + ", at most " +
                          protocol::bytes_text(environment_bytes_max) + " are taken");
    settings.environment_rotate = words.environment_rotate;
    if (settings.environment_rotate != 0 && settings.environment != Environment::picture)
        return refuse(Code::invalid_field,
                      "`environment_rotate` turns a picture: give one with `environment`, or place "
                      "the sun of the sky with `sun`");
    if (!(std::abs(settings.environment_rotate) <= 360))
        return refuse(Code::invalid_field,
                      "`environment_rotate` must lie between -360 and 360 degrees");
    settings.sun = words.sun;
    if (settings.sun && settings.environment == Environment::none)
        return refuse(Code::invalid_field,
                      "`environment` none has no sky, and `sun` is a part of it: leave one of them "
                      "out");
    settings.sun_azimuth = words.sun_azimuth;
    settings.sun_elevation = words.sun_elevation;
    if (settings.sun && std::abs(settings.sun_elevation) > 90)
        return refuse(Code::invalid_field, "sun_elevation must lie between -90 and 90 degrees");
    return settings;
}

/// Chooses the passes of a job.
void set_passes(const RenderWords& words, FilmOptions& options) {
    if (options.progressive || options.best_by_ms != 0 || words.job.detach) {
        options.passes = refinement_passes(options.samples);
        return;
    }
    options.streams_tiles = words.encode == "raw";
    // Tiles are shown with the exposure of a first look at the whole picture.
    if (options.streams_tiles && !options.look.exposure && options.samples > 1)
        options.passes.push_back(1);
    options.passes.push_back(options.samples);
}

/// The parts of a request that shape its samples, as text that a client can turn back into the
/// request.
std::vector<Attribute> request_attributes(const RenderWords& words, const FilmOptions& options) {
    std::string asked = "first";
    const CameraRequest& camera = words.camera;
    if (!camera.name.empty()) asked = "name " + camera.name;
    if (camera.look_at) {
        asked = "lookat";
        const auto add = [&asked](const Vec3& v) {
            for (const float x : {v.x, v.y, v.z}) asked.append(" ").append(number_text(x));
        };
        add(camera.eye);
        add(camera.at);
        if (camera.up) add(*camera.up);
    }
    std::string set;
    for (const std::string& setting : words.job.settings)
        set.append(set.empty() ? "" : " ").append(setting);
    // Another table makes another film; whoever adds samples brings the same one again.
    for (const NamedTable& table : words.job.tables)
        set.append(set.empty() ? "" : " ")
            .append(table.name)
            .append("=")
            .append(table_text(table.values));
    const IntegratorSettings& settings = options.settings;
    std::vector<Attribute> attributes = {
        {"raynest:version", RAYNEST_VERSION},
        {"raynest:integrator", options.integrator},
        {"raynest:width", number_text(words.pixels.whole.width)},
        {"raynest:height", number_text(words.pixels.whole.height)},
        {"raynest:spp", number_text(options.samples)},
        {"raynest:seed", number_text(options.seed)},
#define RAYNEST_INTEGRATOR_SETTING(name, ...) {"raynest:" #name, number_text(settings.name)},
#include "engine/integrators/integrator_settings.def"
        {"raynest:environment", std::string(words.environment)},
        {"raynest:sun", settings.sun ? number_text(settings.sun_azimuth) + "," +
                                           number_text(settings.sun_elevation)
                                     : std::string("auto")},
        {"raynest:noise", number_text(options.noise)},
        {"raynest:set", set.empty() ? std::string("none") : set},
        {"raynest:camera_asked", asked},
        {"raynest:fov", number_text(camera.fov_degrees)}};
    if (settings.environment == IntegratorSettings::Environment::picture)
        attributes.push_back(
            {"raynest:environment_rotate", number_text(settings.environment_rotate)});
    return attributes;
}

}  // namespace

Reply<FilmOptions> film_options(const RenderWords& words) {
    const auto table = integrator_table();
    const auto info = std::ranges::find(table, words.integrator, &IntegratorInfo::name);
    if (info == table.end())
        return refuse(Code::invalid_field, "unknown integrator '" + std::string(words.integrator) +
                                               "': use one of primary, " + integrator_names());
    FilmOptions options;
    auto settings = integrator_settings(words);
    if (!settings) return tl::unexpected(settings.error());
    options.settings = std::move(*settings);
    std::string_view tonemap = words.tonemap.empty() ? "auto" : words.tonemap;
    if (tonemap == "auto") tonemap = info->lit ? "agx" : "none";
    const auto map = parse_tonemap(tonemap);
    if (!map) return refuse(Code::invalid_field, map.error().message);
    const auto exposure = parse_exposure(!words.exposure.empty() ? words.exposure
                                         : info->lit             ? "auto"
                                                                 : "0");
    if (!exposure) return refuse(Code::invalid_field, exposure.error().message);
    options.look = {*map, *exposure};
    options.integrator = words.integrator;
    options.samples = words.samples;
    options.seed = words.seed;
    options.best_by_ms = words.best_by_ms;
    options.progressive = words.progressive;
    options.noise = words.noise;
    options.resume_bytes = words.resume_bytes;
    const std::uint64_t most =
        exr_bytes_max(words.pixels.whole.width, words.pixels.whole.height, film_layers);
    if (options.resume_bytes > most)
        return refuse(Code::invalid_field,
                      "the EXR to continue has " + protocol::bytes_text(options.resume_bytes) +
                          ", but one of this size has at most " + protocol::bytes_text(most));
    options.environment_bytes = words.environment_bytes;
    set_passes(words, options);
    options.attributes = request_attributes(words, options);
    add_selection(selection_text(words.job.selection), options.attributes);
    return options;
}

}  // namespace raynest::server
