// raynest resume FILE.exr --spp N: adds samples to a lit picture, with the bytes of rendering N at
// once.
#include "client/arguments/shared_options.h"
#include "client/commands/deliver.h"
#include "client/output/output_file.h"
#include "client/requests/film.h"
#include "protocol/limits.h"

namespace raynest::client {

void declare(CommandLine& line, ResumeOptions& resume) {
    constexpr protocol::Limits limits;
    line.add_option("FILE", resume.file, "FILE.exr that render has written").required();
    line.add_whole("--spp,--samples", resume.samples, 1U,
                   static_cast<std::uint32_t>(limits.samples_max),
                   "samples per pixel in the end; the file then has the same bytes as one that "
                   "render makes with that many")
        .required();
    add_output(line, resume.output, {".exr"}, "FILE.exr (the file itself is replaced)");
    line.add_option(
        "--scene", resume.scene,
        "FILE or scene that the picture was made of, if it is not loaded under its name");
    add_environment(line, resume.environment);
    add_progressive(line, resume.progressive);
    add_deadline(line, resume.deadline, "take the picture as it is after this many seconds");
}

Result<void> run(Context& context, const ResumeOptions& options) {
    const std::string& output = options.output.empty() ? options.file : options.output;
    if (auto writable = check_writable(output); !writable) return writable;
    FilmFiles files;
    auto request = resumed_film(options, files);
    if (!request) return tl::unexpected<Failure>(request.error());
    PassConsumer write_pass;
    if (options.progressive && !is_stdout(output))
        write_pass = [&output](const ReceivedFile& picture) {
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

std::unique_ptr<Command> make_resume() {
    return make_command<ResumeOptions>();
}

}  // namespace raynest::client
