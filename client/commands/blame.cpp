// raynest heatmap SCENE --top N: which instances, meshes and materials the work is spent on.
#include "client/commands/deliver.h"
#include "client/ranking.h"

#include <iostream>
#include <string>
#include <utility>

namespace raynest::client {

Result<ReceivedPicture> ask_ranking(Context& context, const HeatmapOptions& options) {
    wire::BlameT request;
    request.job = job_message(options.job);
    request.width = options.camera.width;
    request.height = options.camera.height;
    request.level = options.level;
    request.top = options.top;
    return ask_picture(context.connection, context.progress, options, std::move(request));
}

Result<void> rank(Context& context, const HeatmapOptions& options) {
    auto answer = ask_ranking(context, options);
    if (!answer) return tl::unexpected<Failure>(answer.error());
    if (answer->outcome.detached != 0) {
        print_detached(context, answer->outcome);
        return {};
    }
    return deliver_ranking(context, *answer);
}

Result<void> deliver_ranking(Context& context, const ReceivedPicture& answer) {
    const auto document = read_json(answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    print_notes(answer.outcome);
    if (context.json)
        print_json(*document);
    else
        print_ranking(*document, std::cout);
    return {};
}

}  // namespace raynest::client
