// raynest render SCENE -o FILE: a picture, encoded by the daemon.
#include "client/commands/commands.h"
#include "client/files.h"
#include "client/job.h"

#include <iostream>

namespace raynest::client {

Result<void> run(Context& context, const RenderOptions& options) {
    wire::RenderT request;
    request.job = job_message(options.job);
    request.camera = camera_message(options.camera);
    request.width = options.camera.width;
    request.height = options.camera.height;
    request.integrator = options.integrator;
    request.samples = options.samples;
    request.seed = options.seed;
    request.encode = options.output.substr(options.output.rfind('.') + 1);
    if (auto started = context.connection.start(request, deadline_of(options.job)); !started)
        return started;
    const auto picture = receive_picture(context.connection, context.progress);
    context.progress.clear();
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (auto written = write_file(options.output, picture->bytes); !written) return written;

    print_notes(picture->outcome);
    if (context.json) {
        Json json = outcome_json(picture->outcome);
        json["picture"] = options.output;
        json["width"] = picture->width;
        json["height"] = picture->height;
        print_json(json);
    } else {
        std::cout << options.output << ": " << picture->width << "x" << picture->height << ", "
                  << outcome_text(picture->outcome) << '\n';
    }
    return {};
}

}  // namespace raynest::client
