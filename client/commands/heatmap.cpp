// raynest heatmap SCENE -o FILE: what each pixel's ray costs, as a picture or as raw counts.
#include "client/commands/commands.h"
#include "client/files.h"
#include "client/job.h"
#include "client/npy.h"

#include <array>
#include <cstdio>
#include <iostream>

namespace raynest::client {
namespace {

wire::HeatmapT heatmap_message(const HeatmapOptions& options, bool raw) {
    wire::HeatmapT request;
    request.job = job_message(options.job);
    request.camera = camera_message(options.camera);
    request.width = options.camera.width;
    request.height = options.camera.height;
    request.metric = options.metric;
    request.palette = options.palette;
    request.scale = options.scale;
    request.range = options.range;
    request.count = options.count;
    request.encode = raw ? "raw" : options.output.substr(options.output.rfind('.') + 1);
    return request;
}

/// The counts as a (height, width) array.
Result<std::vector<std::byte>> counts_file(const ReceivedPicture& picture) {
    if (picture.bytes.size() != 4ULL * picture.width * picture.height)
        return fail(Exit::failed, "the daemon sent counts of another size than the picture");
    return format_npy({"<u4", {picture.height, picture.width}, picture.bytes});
}

void print_statistics(const Outcome& outcome) {
    const wire::HeatStatisticsT& heat = outcome.heat;
    std::array<char, 160> line;
    std::snprintf(line.data(), line.size(),
                  "%s per ray: min %u, mean %.2f, p50 %u, p99 %u, max %u, %.2f %% clipped",
                  heat.metric.c_str(), heat.min, heat.mean, heat.p50, heat.p99, heat.max,
                  heat.clipped * 100);
    std::cout << line.data() << '\n';
}

Json statistics_json(const Outcome& outcome) {
    const wire::HeatStatisticsT& heat = outcome.heat;
    Json json{{"metric", heat.metric},  {"min", heat.min}, {"mean", heat.mean},
              {"p50", heat.p50},        {"p99", heat.p99}, {"max", heat.max},
              {"clipped", heat.clipped}};
    json.update(outcome_json(outcome));
    return json;
}

}  // namespace

Result<void> run(Context& context, const HeatmapOptions& options) {
    const bool raw = options.output.ends_with(".npy");
    const auto started =
        context.connection.start(heatmap_message(options, raw), deadline_of(options.job));
    if (!started) return started;
    auto picture = receive_picture(context.connection, context.progress);
    context.progress.clear();
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (raw) {
        auto file = counts_file(*picture);
        if (!file) return tl::unexpected<Failure>(file.error());
        picture->bytes = std::move(*file);
    }
    if (auto written = write_file(options.output, picture->bytes); !written) return written;

    print_notes(picture->outcome);
    if (context.json) {
        Json json = statistics_json(picture->outcome);
        json["picture"] = options.output;
        print_json(json);
    } else {
        std::cout << options.output << ": " << picture->width << "x" << picture->height << ", "
                  << outcome_text(picture->outcome) << '\n';
        print_statistics(picture->outcome);
    }
    return {};
}

}  // namespace raynest::client
