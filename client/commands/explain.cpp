// raynest explain SCENE --ray ... | --pixel X,Y: how one ray found its hit, as a tree; with an
// integrator, the rays of a path.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/ground/lists.h"
#include "client/ground/numbers.h"
#include "client/output/explanation.h"
#include "client/output/outcome_text.h"
#include "client/output/output.h"
#include "client/requests/film.h"
#include "client/requests/picture.h"
#include "client/requests/rays.h"
#include "client/requests/scene_origin.h"
#include "protocol/limits.h"

#include <array>
#include <chrono>
#include <iostream>
#include <memory>
#include <string>

namespace raynest::client {
namespace {

struct ExplainOptions : LightOptions {
    JobOptions job;
    CameraOptions camera;
    std::optional<WorldRay> ray;  ///< else the pixel's
    std::optional<std::array<std::uint32_t, 2>> pixel;
    bool all = false;          ///< as many steps as the daemon tells
    std::uint32_t sample = 0;  ///< with an integrator: the one whose path is told
};

wire::ExplainT explain_message(const ExplainOptions& options, const WorldPoint& origin) {
    wire::ExplainT request;
    request.job = job_message(options.job);
    request.camera = camera_message(options.camera, origin);
    request.width = options.camera.width;
    request.height = options.camera.height;
    if (options.pixel) {
        request.pixel_x = (*options.pixel)[0];
        request.pixel_y = (*options.pixel)[1];
    }
    if (options.ray) {
        std::array<float, 8> ray{};
        RaySource({*options.ray}, origin).read(0, ray);
        request.origin = std::make_unique<wire::Vec3>(ray[0], ray[1], ray[2]);
        request.tmin = ray[3];
        request.direction = std::make_unique<wire::Vec3>(ray[4], ray[5], ray[6]);
        request.tmax = ray[7];
    }
    if (options.all)
        request.steps = static_cast<std::uint32_t>(protocol::Limits{}.explain_steps_max);
    return request;
}

/// The request for the rays of a path.
wire::RenderT path_message(const ExplainOptions& options, const WorldPoint& origin) {
    wire::RenderT request;
    request.job = job_message(options.job);
    request.camera = camera_message(options.camera, origin);
    request.width = options.camera.width;
    request.height = options.camera.height;
    set_light(options, request);
    request.samples = options.sample + 1;
    request.encode =
        "path+" + std::to_string((*options.pixel)[0]) + "," + std::to_string((*options.pixel)[1]);
    return request;
}

}  // namespace

void declare(CommandLine& line, ExplainOptions& explain) {
    add_job(line, explain.job);
    add_moment(line, explain.job);
    add_camera(line, explain.camera);
    const Option pixel = line.add_parsed(
        "--pixel",
        [&explain](const std::string& text) -> std::string {
            const auto numbers = parse_pixel(text);
            if (!numbers) return numbers.error().message;
            explain.pixel = *numbers;
            return "";
        },
        "the pixel of the camera's picture, from 0,0 in its upper left corner");
    pixel.type_name("X,Y");
    const Option ray = line.add_parsed(
        "--ray",
        [&explain](const std::string& text) -> std::string {
            const auto parsed = parse_ray(text);
            if (!parsed) return parsed.error().message;
            explain.ray = *parsed;
            return "";
        },
        std::string(ray_form) + ", in place of a pixel");
    ray.excludes(pixel);
    for (const char* other : {"--camera", "--lookat", "--fov", "--size"})
        ray.excludes(line.find(other));
    const Option all =
        line.add_flag("--all", explain.all, "all steps of a long traversal, not the first 256");
    std::string integrators;
    for (const IntegratorWords& each : integrator_words)
        integrators.append(integrators.empty() ? "" : " | ").append(each.name);
    add_light(
        line, explain,
        "the rays of a path in place of a traversal: " + integrators + ", as render has them");
    line.add_whole("--sample", explain.sample, 0U,
                   static_cast<std::uint32_t>(protocol::Limits{}.samples_max - 1),
                   "number of the sample whose path is shown (0)");
    ray.excludes(line.find("--integrator"));
    all.excludes(line.find("--integrator"));
    const auto needs_integrator = [&line](std::string_view option) {
        line.find(std::string(option)).needs(line.find("--integrator"));
    };
    for (const char* other : {"--seed", "--env", "--sun", "--sample"}) needs_integrator(other);
    each_setting([&](const SettingWords& setting) { needs_integrator(setting.option); });
    line.at_end([&explain] {
        return !explain.ray && !explain.pixel ? "--ray or --pixel is required" : "";
    });
}

Result<void> run(Context& context, const ExplainOptions& options) {
    if (const std::string& word = options.environment;
        !word.empty() && word != "auto" && word != "sky" && word != "none")
        return fail(Exit::usage,
                    "--env of explain is sky, none or auto: a path is explained "
                    "without files");
    const auto origin = ask_origin(context.connection, options.job.scene);
    if (!origin) return tl::unexpected<Failure>(origin.error());
    const bool lit = !options.integrator.empty() && options.pixel;
    const std::chrono::milliseconds deadline = deadline_of(options.job.deadline);
    if (auto started =
            lit ? context.connection.start(path_message(options, origin->point), deadline)
                : context.connection.start(explain_message(options, origin->point), deadline);
        !started)
        return started;
    const auto answer = receive_file(context.connection, context.progress, document_room());
    context.progress.clear();
    if (!answer) return tl::unexpected<Failure>(answer.error());
    if (auto same = check_origin(origin->point, answer->outcome.origin); !same) return same;
    const auto document = read_json(*answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    print_notes(answer->outcome);
    if (context.json)
        print_json(*document);
    else if (lit)
        print_path(*document, std::cout);
    else
        print_explanation(*document, std::cout);
    return {};
}

std::unique_ptr<Command> make_explain() {
    return make_command<ExplainOptions>();
}

}  // namespace raynest::client
