// raynest render SCENE -o FILE: a picture, encoded by the daemon, or raw pixels.
#include "client/commands/deliver.h"
#include "client/output_file.h"

#include <iostream>
#include <utility>

namespace raynest::client {

Result<void> run(Context& context, const RenderOptions& options) {
    if (!options.job.detach)
        if (auto writable = check_writable(options.output); !writable) return writable;
    auto request = picture_request<wire::RenderT>(options);
    request.integrator = options.integrator;
    request.samples = options.samples;
    request.seed = options.seed;
    auto picture = ask_picture(context.connection, context.progress, options, request);
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (picture->outcome.detached != 0) {
        print_detached(context, picture->outcome);
        return {};
    }
    return deliver_render(context, options.output, std::move(*picture));
}

Result<void> deliver_render(Context& context, const std::string& output, ReceivedPicture picture) {
    if (picture.encode == "raw") {
        auto file = npy_file(picture, "|u1", {picture.height, picture.width, 4});
        if (!file) return tl::unexpected<Failure>(file.error());
        picture.bytes = std::move(*file);
    }
    if (auto written = write_file(output, picture.bytes); !written) return written;

    print_notes(picture.outcome);
    if (context.json)
        print_json(picture_json(output, picture), summary_of(output));
    else
        summary_of(output) << picture_text(output, picture) << '\n';
    return {};
}

}  // namespace raynest::client
