// raynest render SCENE -o FILE: a picture, encoded by the daemon.
#include "client/commands/commands.h"
#include "client/files.h"
#include "client/picture.h"

#include <iostream>

namespace raynest::client {

Result<void> run(Context& context, const RenderOptions& options) {
    if (auto writable = check_writable(options.output); !writable) return writable;
    auto request = picture_request<wire::RenderT>(options);
    request.integrator = options.integrator;
    request.samples = options.samples;
    request.seed = options.seed;
    const auto picture = ask_picture(context.connection, context.progress, options, request);
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (auto written = write_file(options.output, picture->bytes); !written) return written;

    print_notes(picture->outcome);
    if (context.json)
        print_json(picture_json(options.output, *picture));
    else
        std::cout << picture_text(options.output, *picture) << '\n';
    return {};
}

}  // namespace raynest::client
