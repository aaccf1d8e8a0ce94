// raynest render SCENE -o FILE: a picture, encoded by the daemon, or raw pixels.
#include "client/arguments/shared_options.h"
#include "client/commands/by_python.h"
#include "client/commands/deliver.h"
#include "client/files/files.h"
#include "client/output/output_file.h"
#include "client/requests/film.h"
#include "protocol/limits.h"

#include <utility>

namespace raynest::client {
namespace {

/// Returns "out.3.png" of "out.png".
std::string numbered(const std::string& output, std::size_t number) {
    const std::size_t dot = output.size() - extension_of(output).size();
    return output.substr(0, dot) + "." + std::to_string(number) + output.substr(dot);
}

Result<void> render_one(Context& context, const RenderOptions& options) {
    if (!options.job.detach)
        if (auto writable = check_writable(options.output); !writable) return writable;
    if (options.part.count != 0 && encoding_of(options.output) == "raw")
        return fail(Exit::usage,
                    "--part: a .npy does not say which part it is: write a .png, of which raynest "
                    "merge also makes a .npy");
    auto made = picture_request<wire::RenderT>(options);
    if (!made) return tl::unexpected<Failure>(made.error());
    wire::RenderT& request = *made;
    FilmFiles files;
    if (auto filled = fill_film(options, request, files); !filled) return filled;
    PassConsumer write_pass;
    if (options.progressive && !is_stdout(options.output))
        write_pass = [&options](const ReceivedFile& picture) {
            return write_picture(options.output, picture);
        };
    auto picture =
        ask_film(context.connection, context.progress, options, request, files, write_pass);
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (picture->outcome.detached != 0) {
        print_detached(context, picture->outcome);
        return {};
    }
    return deliver_render(context, options.output, std::move(*picture), request.samples);
}

}  // namespace

void declare(CommandLine& line, RenderOptions& render) {
    add_job(line, render.job);
    add_moment(line, render.job);
    add_camera(line, render.camera);
    add_output(line, render.output, {".png", ".exr", ".npy"},
               "FILE.png, FILE.exr, or FILE.npy of (height, width, 4) bytes");
    add_detach(line, render.job, &render.output);
    add_part(line, render.part);
    add_film(line, render);
    add_progressive(line, render.progressive);
    line.add_parsed(
            "--cameras",
            [&render](const std::string& which) -> std::string {
                render.all_cameras = true;
                return which == "all" ? "" : "takes: all";
            },
            "all: a file for each camera of the scene, FILE.0.png and so on")
        .excludes(line.find("--camera"))
        .excludes(line.find("--lookat"))
        .excludes(line.find("--detach"));
    add_trajectory(line, render);
}

Result<void> run(Context& context, const RenderOptions& options) {
    if (!options.all_cameras) return render_one(context, options);
    if (is_stdout(options.output))
        return fail(Exit::usage, "--cameras all writes several files: name one with -o");
    wire::InfoT info;
    info.scene = options.job.scene;
    const auto described = ask<wire::SceneInfo>(context.connection, info);
    if (!described) return tl::unexpected<Failure>(described.error());
    const auto* cameras = (*described)->cameras();
    if (cameras == nullptr || cameras->size() == 0)
        return fail(Exit::invalid, "the scene has no cameras: leave --cameras out");
    for (std::size_t i = 0; i < cameras->size(); ++i) {
        RenderOptions one = options;
        one.camera.name = std::to_string(i);
        one.output = numbered(options.output, i);
        if (auto done = render_one(context, one); !done) return done;
    }
    return {};
}

namespace {

class Render final : public PythonCommandOf<RenderOptions> {
    [[nodiscard]] std::optional<Parts> parts() const override {
        return picture_parts(options_, samples_of(options_));
    }
};

}  // namespace

std::unique_ptr<Command> make_render() {
    return std::make_unique<Render>();
}

}  // namespace raynest::client
