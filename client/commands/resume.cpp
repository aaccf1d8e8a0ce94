// raynest resume FILE.exr --spp N: adds samples to a lit picture, with the bytes of rendering N at
// once.
#include "client/commands/deliver.h"
#include "client/output/output_file.h"
#include "client/requests/film.h"

namespace raynest::client {

Result<void> run(Context& context, const ResumeOptions& options) {
    const std::string& output = options.output.empty() ? options.file : options.output;
    if (auto writable = check_writable(output); !writable) return writable;
    FilmFiles files;
    auto request = resumed_film(options, files);
    if (!request) return tl::unexpected<Failure>(request.error());
    PassConsumer write_pass;
    if (options.progressive && !is_stdout(output))
        write_pass = [&output](const ReceivedPicture& picture) {
            return write_picture(output, picture);
        };
    auto picture = run_film(context.connection, context.progress, *request, files, write_pass);
    context.progress.clear();
    const auto unknown = static_cast<std::uint32_t>(protocol::Code::scene_unknown);
    if (!picture && picture.error().code == unknown && options.scene.empty())
        return fail(picture.error().exit,
                    options.file + " was made of '" + request->job->scene +
                        "', which is not loaded: name the file or the scene that it was made of "
                        "with --scene");
    if (!picture) return tl::unexpected<Failure>(picture.error());
    return deliver_render(context, output, std::move(*picture), options.samples);
}

}  // namespace raynest::client
