// raynest export SCENE -o FILE: a scene of the daemon as a file that other programs read.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/output/outcome_text.h"
#include "client/output/output.h"
#include "client/output/output_file.h"
#include "client/requests/job.h"
#include "client/requests/picture.h"

#include <filesystem>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

struct ExportOptions {
    std::string scene, output;
    std::uint64_t epoch = 0;  ///< 0: the current one
    MomentOptions moment;
};

constexpr std::string_view composition_ending = ".rnscene.json";

Result<ReceivedFile> receive_file(Context& context, const ExportOptions& options,
                                  const std::string& format, const std::string& file) {
    wire::ExportT request;
    request.scene = options.scene;
    request.epoch = options.epoch;
    request.format = format;
    request.file = file;
    put_moment(options.moment, request);
    if (auto started = context.connection.start(request); !started)
        return tl::unexpected<Failure>(started.error());
    auto answer = receive_file(context.connection, context.progress, file_room());
    context.progress.clear();
    return answer;
}

}  // namespace

void declare(CommandLine& line, ExportOptions& options) {
    add_scene(line, options.scene);
    add_output(line, options.output, {".glb", std::string(composition_ending)},
               "binary glTF 2.0; or a composition, which keeps the scene's origin, with the .glb "
               "that it places beside it")
        .required();
    add_epoch(line, options.epoch);
    add_moment(line, options.moment);
}

Result<void> run(Context& context, const ExportOptions& options) {
    const bool composes = extension_of(options.output) == ".json";
    if (composes && options.output.starts_with(standard_stream))
        return fail(Exit::usage, "a composition places a .glb beside it: name a file for -o");
    std::string glb = options.output;
    if (composes) glb.replace(glb.size() - composition_ending.size(), std::string::npos, ".glb");
    const std::string file_name = glb.substr(glb.rfind('/') + 1);
    if (composes && file_name.find_first_of(":\\") != std::string::npos)
        return fail(Exit::usage, "a composition cannot name " + shown_name(file_name) +
                                     ": leave ':' and '\\' out of the name of -o");
    std::error_code error;
    if (composes && std::filesystem::exists(glb, error) &&
        !std::filesystem::exists(options.output, error))
        return fail(Exit::usage, shown_name(glb) +
                                     " exists, and the composition would replace it: "
                                     "name another file for -o, or move it away");
    for (const std::string& path : {glb, options.output})
        if (auto writable = check_writable(path); !writable) return writable;
    const auto file = receive_file(context, options, "glb", "");
    if (!file) return tl::unexpected<Failure>(file.error());
    std::vector<std::byte> composition;
    if (composes) {
        // It says where the scene lies, which edits do not change.
        auto text = receive_file(context, options, "rnscene.json", file_name);
        if (!text) return tl::unexpected<Failure>(text.error());
        if (text->outcome.origin != file->outcome.origin)
            return fail(Exit::failed, "the scene '" + options.scene +
                                          "' was replaced while it was exported: export it again");
        composition = std::move(text->bytes);
    }
    // Both are here before one is written: beside the composition of another epoch a file would
    // stand elsewhere.
    if (auto written = write_file(glb, file->bytes); !written) return written;
    if (composes)
        if (auto written = write_file(options.output, composition); !written) return written;
    const Outcome& outcome = file->outcome;
    print_notes(outcome);
    if (context.json) {
        print_json(Json{{"scene", outcome.scene},
                        {"epoch", outcome.epoch},
                        {"hash", outcome.hash},
                        {"file", options.output},
                        {"glb", glb},
                        {"bytes", file->bytes.size()},
                        {"notes", outcome.notes}});
    } else {
        summary_of(options.output)
            << options.output << (composes ? " and " + glb : std::string()) << ": " << outcome.scene
            << ", epoch " << outcome.epoch << ", " << file->bytes.size() << " bytes of glTF\n";
    }
    return {};
}

std::unique_ptr<Command> make_export() {
    return make_command<ExportOptions>();
}

}  // namespace raynest::client
