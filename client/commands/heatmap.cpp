// raynest heatmap SCENE -o FILE: what each pixel's ray costs, as a picture or as raw counts.
#include "client/commands/deliver.h"
#include "client/output_file.h"

#include <array>
#include <cstdio>
#include <iostream>
#include <utility>

namespace raynest::client {
namespace {

wire::HeatmapT heatmap_message(const HeatmapOptions& options) {
    auto request = picture_request<wire::HeatmapT>(options);
    request.metric = options.metric;
    request.palette = options.palette;
    request.scale = options.scale;
    request.range = options.range;
    request.count = options.count;
    return request;
}

void print_statistics(const wire::HeatStatisticsT& heat, std::ostream& to) {
    std::array<char, 200> line;
    std::snprintf(line.data(), line.size(),
                  "%s%s per ray: min %u, mean %.2f, p50 %u, p99 %u, max %u, %.2f %% clipped",
                  heat.count == "necessary" ? "necessary " : "", heat.metric.c_str(), heat.min,
                  heat.mean, heat.p50, heat.p99, heat.max, heat.clipped * 100);
    to << line.data();
    if (heat.below > 0) {
        std::snprintf(line.data(), line.size(), ", %.2f %% below the range", heat.below * 100);
        to << line.data();
    }
    to << '\n';
}

Json statistics_json(const wire::HeatStatisticsT& heat) {
    return Json{{"metric", heat.metric},
                {"min", heat.min},
                {"mean", heat.mean},
                {"p50", heat.p50},
                {"p90", heat.p90},
                {"p99", heat.p99},
                {"max", heat.max},
                {"clipped", heat.clipped},
                {"below", heat.below},
                {"count", heat.count},
                {"range_low", heat.range_low},
                {"range_high", heat.range_high}};
}

}  // namespace

Result<void> run(Context& context, const HeatmapOptions& options) {
    if (options.top != 0 && options.output.empty()) return rank(context, options);
    if (!options.job.detach)
        if (auto writable = check_writable(options.output); !writable) return writable;
    auto picture =
        ask_picture(context.connection, context.progress, options, heatmap_message(options));
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (picture->outcome.detached != 0) {
        print_detached(context, picture->outcome);
        return {};
    }
    auto delivered = deliver_heatmap(context, options.output, std::move(*picture));
    return delivered && options.top != 0 ? rank(context, options) : delivered;
}

Result<void> deliver_heatmap(Context& context, const std::string& output, ReceivedPicture picture) {
    if (picture.encode == "raw") {
        auto file = npy_file(picture, "<u4", {picture.height, picture.width});
        if (!file) return tl::unexpected<Failure>(file.error());
        picture.bytes = std::move(*file);
    }
    if (auto written = write_file(output, picture.bytes); !written) return written;

    print_notes(picture.outcome);
    if (context.json) {
        Json json = statistics_json(picture.outcome.heat);
        json.update(picture_json(output, picture));
        print_json(json, summary_of(output));
    } else {
        summary_of(output) << picture_text(output, picture) << '\n';
        print_statistics(picture.outcome.heat, summary_of(output));
    }
    return {};
}

}  // namespace raynest::client
