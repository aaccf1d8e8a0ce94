// The options of lit pictures, as CLI11 declares them. Included by options.cpp alone, as
// option_parts.h is.
#pragma once

#include "client/commands/option_parts.h"

namespace raynest::client {

inline void add_progressive(CLI::App& app, bool& progressive) {
    app.add_flag("--progressive", progressive,
                 "write the whole picture after each pass: with 1, 2, 4, ... samples");
}

inline void add_environment(CLI::App& app, std::string& environment) {
    app.add_option("--env", environment,
                   "what lights from afar: sky | none | auto (sky, unless the file has lights) | "
                   "FILE.exr or FILE.hdr, a picture all around whose middle lies at +X");
}

/// Adds what chooses the paths of light; samples are the caller's.
inline void add_light(CLI::App& app, LightOptions& light, const std::string& integrators) {
    constexpr protocol::Limits limits;
    app.add_option("--integrator", light.integrator, integrators);
    add_whole(app, "--seed", light.seed, std::uint64_t{0}, any_whole,
              "seed of the random numbers (0)");
    add_whole(app, "--depth", light.depth, 1U, static_cast<std::uint32_t>(limits.bounces_max),
              "of path: bounces at most (8)");
    add_number(app, "--ao-distance", light.ao_distance, 1e-9F, 1e15F,
               "a length from 1e-9 to 1e15",
               "of ao: as far as things hide the sky (a tenth of the scene)");
    add_environment(app, light.environment);
    add_parsed(
        app, "--sun",
        [&light](const std::string& text) -> std::string {
            const auto numbers = parse_world(text, 2, 2, "azimuth,elevation");
            if (!numbers) return numbers.error().message;
            const double azimuth = (*numbers)[0];
            const double elevation = (*numbers)[1];
            if (!(std::abs(azimuth) <= 360 && std::abs(elevation) <= 90))
                return "'" + text + "' is not an azimuth within 360 and an elevation within 90 "
                                    "degrees";
            light.sun = {static_cast<float>(azimuth), static_cast<float>(elevation)};
            return "";
        },
        "the sky's sun: degrees from the north (-Z) eastwards, degrees above the horizon")
        ->type_name("AZIMUTH,ELEVATION");
}

inline void add_render(CLI::App& app, RenderOptions& render) {
    constexpr protocol::Limits limits;
    add_job(app, render.job);
    add_camera(app, render.camera);
    add_output(app, render.output, {".png", ".exr", ".npy"},
               "FILE.png, FILE.exr, or FILE.npy of (height, width, 4) bytes");
    add_detach(app, render.job, &render.output);
    add_light(app, render,
              "primary (base colour, darker where it turns away; one ray per pixel) | ao (open or hidden from the sky) | "
              "direct (lights and shadows) | path (all light)");
    add_whole(app, "--spp,--samples", render.samples, 1U,
              static_cast<std::uint32_t>(limits.samples_max),
              "samples per pixel (16, with --noise 1024; primary has 1)");
    app.add_option("--tonemap", render.tonemap,
                   "of .png and .npy: agx | aces | reinhard | none (agx; ao none)");
    app.add_option("--exposure", render.exposure,
                   "of .png and .npy: stops, or auto (auto; ao 0)");
    add_number(app, "--env-rotate", render.environment_rotate, -360.0F, 360.0F,
               "a number of degrees from -360 to 360",
               "turns the picture of --env by so many degrees from -Z towards +X (0)")
        ->type_name("DEGREES");
    add_progressive(app, render.progressive);
    add_number(app, "--noise", render.noise, 1e-6F, 1.0F, "a number from 0.000001 to 1",
               "end parts of the picture when their error, as a share of their brightness, is "
               "below this; --spp is then the most");
    app.add_option_function<std::string>(
           "--cameras",
           [&render](const std::string& which) {
               if (which != "all") throw CLI::ValidationError("--cameras", "takes: all");
               render.all_cameras = true;
           },
           "all: a file for each camera of the scene, FILE.0.png and so on")
        ->excludes(app.get_option("--camera"))
        ->excludes(app.get_option("--lookat"))
        ->excludes(app.get_option("--detach"));
}

inline void add_resume(CLI::App& app, ResumeOptions& resume) {
    constexpr protocol::Limits limits;
    app.add_option("FILE", resume.file, "FILE.exr that render has written")->required();
    add_whole(app, "--spp,--samples", resume.samples, 1U,
              static_cast<std::uint32_t>(limits.samples_max),
              "samples per pixel in the end; the file has the bytes of render with as many")
        ->required();
    add_output(app, resume.output, {".exr"}, "FILE.exr (the file itself is replaced)");
    app.add_option("--scene", resume.scene, "FILE or scene that the picture was made of, where it is not loaded under its name");
    add_environment(app, resume.environment);
    add_progressive(app, resume.progressive);
    add_deadline(app, resume.deadline, "take the picture as it is after so many seconds");
}

}  // namespace raynest::client
