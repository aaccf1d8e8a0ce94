// raynest heatmap SCENE -o FILE: what each pixel's ray costs, as a picture, as raw counts or as a
// report; compared with another scene or setting, and checked against limits.
#include "client/arguments/shared_options.h"
#include "client/commands/deliver.h"
#include "client/files/exr_header.h"
#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/ground/lists.h"
#include "client/output/fail_if.h"
#include "client/output/output_file.h"
#include "client/output/report.h"
#include "client/requests/difference.h"
#include "client/requests/scene_source.h"
#include "client/requests/tables.h"
#include "protocol/base64.h"
#include "protocol/limits.h"

#include <array>
#include <cstdio>
#include <optional>
#include <span>
#include <utility>

namespace raynest::client {
namespace {

struct HeatmapOptions : PictureOptions {
    std::string metric, palette, scale, range, count;
    std::string range_from;                ///< an EXR whose range this map takes
    std::optional<Difference> difference;  ///< the other counts are subtracted
    std::vector<FailIf> fail_if;
    std::string command_line;  ///< for the report: the words of this command, as a shell takes them
    std::uint32_t top = 0;     ///< rows of a ranking; 0: none is asked for
    std::uint32_t level = 0;   ///< level of the instances that it groups by; 0: the innermost
};

/// True if the answer must tell more than one metric, as a document.
bool needs_document(const HeatmapOptions& options) {
    return is_report(options.output) || !options.fail_if.empty();
}

Result<wire::HeatmapT> heatmap_message(const HeatmapOptions& options) {
    auto made = picture_request<wire::HeatmapT>(options);
    if (!made) return made;
    wire::HeatmapT& request = *made;
    request.metric = options.metric;
    request.palette = options.palette;
    request.scale = options.scale;
    request.range = options.range;
    request.count = options.count;
    if (options.difference)
        request.other = job_message(other_job(options.job, *options.difference));
    if (needs_document(options))
        request.encode = options.output.empty() ? "json" : "json+" + request.encode;
    return made;
}

/// Asks for the ranking of the rays.
Result<ReceivedFile> ask_ranking(Context& context, const HeatmapOptions& options) {
    wire::BlameT request;
    request.job = job_message(options.job);
    request.width = options.camera.width;
    request.height = options.camera.height;
    request.level = options.level;
    request.top = options.top;
    return ask_picture(context.connection, context.progress, options, std::move(request));
}

/// The ranking of --top, in place of a picture or after it.
Result<void> rank(Context& context, const HeatmapOptions& options) {
    auto answer = ask_ranking(context, options);
    if (!answer) return tl::unexpected<Failure>(answer.error());
    if (answer->outcome.detached != 0) {
        print_detached(context, answer->outcome);
        return {};
    }
    return deliver_ranking(context, *answer);
}

/// Replaces the answer's document by the file that it holds.
Result<void> take_file(const Json& document, const std::string& encode, ReceivedFile& picture) {
    const Json& file = document.at("file");
    auto bytes = protocol::from_base64(file.at("base64").get_ref<const std::string&>());
    if (!bytes) return daemon_sent("a file that is not Base64");
    picture.encode = file.at("encode").get<std::string>();
    if (picture.encode != encode) return daemon_sent("another file than was asked for");
    picture.width = file.at("width").get<std::uint32_t>();
    picture.height = file.at("height").get<std::uint32_t>();
    picture.bytes = std::move(*bytes);
    return {};
}

/// "from (0, 1, 5) to (0, 0, 0), 40°" of --lookat; "" of a camera with a name.
std::string camera_words(const CameraOptions& camera) {
    if (camera.look_at.size() < 6) return "";
    const auto point = [&](std::size_t first) {
        std::array<char, 96> text{};
        std::snprintf(text.data(), text.size(), "(%.4g, %.4g, %.4g)", camera.look_at[first],
                      camera.look_at[first + 1], camera.look_at[first + 2]);
        return std::string(text.data());
    };
    std::array<char, 32> angle{};
    if (camera.fov_degrees > 0)
        std::snprintf(angle.data(), angle.size(), ", %.4g°",
                      static_cast<double>(camera.fov_degrees));
    return std::string("from ").append(point(0)).append(" to ").append(point(3)).append(
        angle.data());
}

/// Asks for what stands beside the heat map in a report, of the same epoch. Returns the ranking.
Result<ReceivedFile> write_report(Context& context, const HeatmapOptions& options,
                                  const ReceivedFile& heat, Report report) {
    HeatmapOptions same = options;
    same.job.epoch = heat.outcome.epoch;
    auto render = picture_request<wire::RenderT>(same);
    if (!render) return tl::unexpected<Failure>(render.error());
    auto picture = ask_picture(context.connection, context.progress, same, std::move(*render));
    if (!picture) return tl::unexpected<Failure>(picture.error());
    report.picture = std::move(picture->bytes);
    auto ranking = ask_ranking(context, same);
    if (!ranking) return tl::unexpected<Failure>(ranking.error());
    auto document = read_json(*ranking);
    if (!document) return tl::unexpected<Failure>(document.error());
    report.ranking = shown_json(*document);
    const std::string html = report_html(report);
    if (auto written = write_file(options.output, std::as_bytes(std::span(html))); !written)
        return tl::unexpected<Failure>(written.error());
    return std::move(*ranking);
}

/// Delivers an answer that is a document: the file in it or a report, and the verdicts. Sets
/// `ranking` to that of a report.
Result<void> deliver_document(Context& context, const HeatmapOptions& options, ReceivedFile answer,
                              std::optional<ReceivedFile>& ranking) {
    auto document = read_json(answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    const auto verdicts = judge(options.fail_if, *document);
    if (!verdicts) return tl::unexpected<Failure>(verdicts.error());
    if (!options.output.empty())
        if (auto taken = take_file(*document, encoding_of(options.output), answer); !taken)
            return taken;
    if (is_report(options.output)) {
        auto written = write_report(context, options, answer,
                                    {shown_json(*document),
                                     {},
                                     {},
                                     *verdicts,
                                     options.command_line,
                                     camera_words(options.camera)});
        if (!written) return tl::unexpected<Failure>(written.error());
        ranking = std::move(*written);
    }
    return deliver_heatmap(context, options.output, std::move(answer), *verdicts);
}

/// Fills in what the options leave to files: the range of --range-from, and a scene to compare with
/// and its tables.
Result<void> complete(Context& context, HeatmapOptions& options) {
    if (!options.range_from.empty()) {
        auto range =
            read_exr_range(options.range_from, options.metric.empty() ? "total" : options.metric,
                           options.difference.has_value());
        if (!range) return tl::unexpected<Failure>(range.error());
        options.range = std::move(*range);
    }
    if (!options.difference) return {};
    if (auto read = read_tables(options.difference->settings, options.difference->tables); !read)
        return read;
    if (!is_source(options.difference->scene)) return {};
    auto name =
        load_for_connection(context.connection, context.progress, options.difference->scene);
    if (!name) return tl::unexpected<Failure>(name.error());
    options.difference->scene = std::move(*name);
    return {};
}

}  // namespace

void declare(CommandLine& line, HeatmapOptions& heatmap) {
    add_job(line, heatmap.job);
    add_moment(line, heatmap.job);
    add_camera(line, heatmap.camera);
    add_output(
        line, heatmap.output, {".png", ".exr", ".npy", ".html"},
        "FILE.png with a legend; FILE.exr of every metric and level, FILE.npy of raw counts; "
        "FILE.html, a report to attach to a ticket");
    add_detach(line, heatmap.job, &heatmap.output);
    add_part(line, heatmap.part);
    line.add_option("--metric", heatmap.metric,
                    alternatives(metric_words) +
                        " (total); boxes.1 is level 1 alone, time is measured in nanoseconds");
    line.add_option("--palette", heatmap.palette, alternatives(palette_words));
    line.add_option("--scale", heatmap.scale, "linear | log");
    const Option range = line.add_option("--range", heatmap.range,
                                         "p99 | auto | LOW:HIGH; for a difference -HIGH:HIGH");
    line.add_option("--range-from", heatmap.range_from,
                    "FILE.exr of a heat map: take the same range")
        .excludes(range);
    line.add_option("--count", heatmap.count, "traversed | necessary");
    line.add_each(
        "--diff",
        [&heatmap](const std::string& text) {
            if (!heatmap.difference) heatmap.difference.emplace();
            return read_difference(text, *heatmap.difference);
        },
        "subtract what the same rays cost in OTHER_SCENE, or with KEY=VALUE: intersector, mask, "
        "epoch, or a parameter of the intersector; may be repeated. Red pixels cost more here, "
        "blue ones less");
    line.add_each(
        "--fail-if",
        [&heatmap](const std::string& text) -> Result<void> {
            auto check = parse_fail_if(text);
            if (!check) return tl::unexpected<Failure>(check.error());
            heatmap.fail_if.push_back(std::move(*check));
            return {};
        },
        "'METRIC[.LEVEL].STATISTIC OP NUMBER', as 'total.p99>120', or 'levels|bytes|triangles OP "
        "NUMBER': end with exit code 9 if that is true; may be repeated. Statistics: min mean "
        "p50 p90 p99 max; OP: > >= < <=. With it no -o is needed");
    const Option top = line.add_whole(
        "--top", heatmap.top, 1U, static_cast<std::uint32_t>(protocol::Limits{}.list_items_max),
        "print this many of the instances, meshes and materials in which most work is done, and a "
        "diagnosis. Work is counted, whatever --metric is. With it no -o is needed");
    line.add_whole("--level", heatmap.level, 1U, 31U,
                   "for --top: group by the instances of this level, 1 for those of the root (the "
                   "innermost)")
        .needs(top);
    line.at_end([&heatmap]() -> std::string {
        const bool has_detach = heatmap.job.detach;
        const bool is_part = heatmap.part.count != 0;
        if (is_part && heatmap.top != 0)
            return "--part: leave it out with --top, which ranks the work of all rays at once";
        if (is_part && !heatmap.fail_if.empty())
            return "--part: give --fail-if to raynest merge, which has the counts of all pixels";
        if (is_part && extension_of(heatmap.output) != ".exr")
            return "--part: makes a .exr alone: write that, and raynest merge joins the parts, "
                   "also to a .png or a .npy; a report needs all rays at once";
        if (heatmap.output.empty() && !has_detach && heatmap.top == 0 && heatmap.fail_if.empty())
            return "--output, --top or --fail-if is required";
        if (heatmap.output.empty() && heatmap.top != 0 &&
            !(heatmap.palette.empty() && heatmap.scale.empty() && heatmap.range.empty() &&
              heatmap.range_from.empty()))
            return "--palette, --scale and --range: colour a picture; add -o, or leave them out";
        if (!heatmap.output.empty() && has_detach && heatmap.top != 0)
            return "--detach: takes one job: ask for -o or for --top";
        if (has_detach && (is_report(heatmap.output) || !heatmap.fail_if.empty()))
            return "--detach: ends before there is an answer: leave it out with --fail-if and a "
                   "report";
        return "";
    });
}

Result<void> run(Context& context, const HeatmapOptions& asked) {
    if (asked.top != 0 && asked.difference && !is_report(asked.output))
        return fail(Exit::usage,
                    "--top ranks the work of one scene and --diff compares two: leave one "
                    "of them out");
    if (asked.top != 0 && asked.output.empty() && asked.fail_if.empty())
        return rank(context, asked);
    HeatmapOptions options = asked;
    if (!options.job.detach && !options.output.empty())
        if (auto writable = check_writable(options.output); !writable) return writable;
    if (auto completed = complete(context, options); !completed) return completed;
    auto request = heatmap_message(options);
    if (!request) return tl::unexpected<Failure>(request.error());
    auto picture = ask_picture(context.connection, context.progress, options, std::move(*request));
    if (!picture) return tl::unexpected<Failure>(picture.error());
    if (picture->outcome.detached != 0) {
        print_detached(context, picture->outcome);
        return {};
    }
    std::optional<ReceivedFile> ranking;
    auto delivered = needs_document(options)
                         ? deliver_document(context, options, std::move(*picture), ranking)
                         : deliver_heatmap(context, options.output, std::move(*picture));
    // The ranking helps most where a limit is exceeded.
    const bool ranks = options.top != 0 && !options.difference &&
                       (delivered || delivered.error().exit == Exit::threshold);
    if (ranks) {
        auto ranked = ranking ? deliver_ranking(context, *ranking) : rank(context, options);
        if (!ranked) return ranked;
    }
    return delivered;
}

namespace {

class Heatmap final : public CommandOf<HeatmapOptions> {
    [[nodiscard]] const std::string* other_scene() const override {
        return options_.difference ? &options_.difference->scene : nullptr;
    }
    [[nodiscard]] std::optional<Parts> parts() const override { return picture_parts(options_, 1); }
    void told(const std::string& words) override { options_.command_line = words; }
};

}  // namespace

std::unique_ptr<Command> make_heatmap() {
    return std::make_unique<Heatmap>();
}

}  // namespace raynest::client
