// HEATMAP: the cost of each pixel's ray, as raw counts or as a picture.
#include "engine/assets/image.h"
#include "engine/integrators/picture.h"
#include "server/handlers/handler.h"
#include "server/handlers/picture_job.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

/// Bytes per pixel: the count, a sorted copy for percentiles, the picture and the encoded file.
constexpr std::uint64_t pixel_bytes = 4 * sizeof(std::uint32_t);
/// The same for each channel of an EXR: the counts, interleaved, and the file while it grows.
constexpr std::uint64_t channel_bytes = 5 * sizeof(std::uint32_t);

/// Returns the bytes that a job holds. A narrow map is widened to the width of its legend.
std::uint64_t heat_bytes(std::uint32_t width, std::uint32_t height, std::size_t metrics) {
    const std::uint64_t pixels = std::uint64_t{std::max(width, heat_picture_width_min)} * height;
    return (metrics == 1 ? pixel_bytes : sizeof(std::uint32_t) + channel_bytes * metrics) * pixels;
}

/// Returns what a map counts: an EXR every metric in total and of each level, others the one asked
/// for.
std::vector<Column> metrics_of(const HeatOptions& options, std::string_view encode,
                               std::uint32_t levels) {
    if (encode != "exr") return {*parse_column(options.metric)};
    std::vector<Column> metrics;
    for (const FieldInfo& counter : counter_table()) {
        metrics.emplace_back(*parse_field(counter.name));
        for (std::uint32_t level = 0; level < levels; ++level)
            metrics.emplace_back(metrics.back().field, level);
    }
    return metrics;
}

/// Returns a channel's name: boxes, and L1.boxes of level 1.
std::string channel_name(const Column& metric) {
    std::string name;
    if (metric.of_level()) name.append("L").append(std::to_string(metric.level)).append(".");
    return name.append(field_info(metric.field).name);
}

/// Returns the maximum bytes of the payload.
std::uint64_t payload_bytes_max(std::uint32_t width, std::uint32_t height, std::string_view encode,
                                std::size_t metrics) {
    if (encode == "png")
        return png_bytes_max(std::max(width, heat_picture_width_min),
                             height + heat_legend_height_max);
    if (encode == "exr") return exr_bytes_max(width, height, static_cast<std::uint32_t>(metrics));
    return sizeof(std::uint32_t) * width * height;
}

class HeatmapJob final : public PictureJob {
public:
    /// `uncounted` is the plan that finds the hits; set only for count "necessary".
    HeatmapJob(const Services& services, const Caller& caller, PictureRequest asked,
               HeatOptions options, std::vector<Column> metrics, std::optional<Plan> uncounted)
        : PictureJob(services, caller, std::move(asked)),
          options_(std::move(options)),
          metrics_(std::move(metrics)),
          uncounted_(std::move(uncounted)) {
        for (std::size_t m = 0; m < metrics_.size(); ++m) counts_.push_back(blank<std::uint32_t>());
    }

protected:
    [[nodiscard]] CastPlans plans() const override {
        return {uncounted_ ? &*uncounted_ : nullptr, nullptr, &plan_};
    }
    std::optional<CameraHits> trace_pixels(const PixelRange& pixels, const ColumnSource& scene,
                                           RayCaster& caster, const PixelArrays& arrays) override {
        std::vector<std::uint32_t> counts(pixels.count * metrics_.size());
        const auto seen =
            measure_work(pixels, scene, caster, arrays, metrics_, uncounted_.has_value(), counts);
        for (std::size_t m = 0; seen && m < metrics_.size(); ++m)
            place<std::uint32_t>(pixels.first,
                                 std::span(counts).subspan(m * pixels.count, pixels.count),
                                 counts_[m].get());
        return seen;
    }

    Reply<Payload> encode() override {
        const std::span<const std::uint32_t> counts = counts_of(*parse_column(options_.metric));
        const auto statistics = heat_statistics(counts, options_);
        if (!statistics) return refuse(statistics.error());
        statistics_ = *statistics;

        Payload payload{request().width, request().height, {}};
        if (request().encode == "raw") {
            payload.bytes.resize(counts.size_bytes());
            std::memcpy(payload.bytes.data(), counts.data(), payload.bytes.size());
            return payload;
        }
        if (request().encode == "exr") {
            auto file = encode_channels();
            if (!file) return refuse(file.error());
            payload.bytes = std::move(*file);
            return payload;
        }
        const auto picture =
            heat_picture(payload.width, payload.height, counts, statistics_, options_);
        if (!picture) return refuse(picture.error());
        auto file = encode_png(picture->width, picture->height, picture->rgba);
        if (!file) return refuse(file.error());
        return Payload{picture->width, picture->height, std::move(*file)};
    }

    void complete(wire::DoneT& done) const override {
        done.heat = std::make_unique<wire::HeatStatisticsT>();
        done.heat->metric = options_.metric;
        done.heat->min = statistics_.min;
        done.heat->mean = statistics_.mean;
        done.heat->p50 = statistics_.p50;
        done.heat->p90 = statistics_.p90;
        done.heat->p99 = statistics_.p99;
        done.heat->max = statistics_.max;
        done.heat->clipped = statistics_.clipped;
        done.heat->range_low = statistics_.range_low;
        done.heat->range_high = statistics_.range_high;
        done.heat->below = statistics_.below;
        done.heat->count = options_.count;
    }

private:
    [[nodiscard]] std::span<const std::uint32_t> counts_of(const Column& metric) const {
        const auto at = std::find(metrics_.begin(), metrics_.end(), metric) - metrics_.begin();
        return {counts_[static_cast<std::size_t>(at)].get(), request().pixels()};
    }

    [[nodiscard]] Result<std::vector<std::byte>> encode_channels() const {
        std::vector<std::string> names;
        for (const Column& metric : metrics_) names.push_back(channel_name(metric));
        std::vector<Channel> channels;
        for (std::size_t m = 0; m < metrics_.size(); ++m)
            channels.push_back({names[m], {}, counts_of(metrics_[m])});
        auto attributes = provenance();
        attributes.push_back({"raynest:metric", options_.metric});
        attributes.push_back({"raynest:count", options_.count});
        attributes.push_back({"raynest:range", range_text(statistics_)});
        return encode_exr(request().width, request().height, channels, attributes);
    }

    /// Returns the range as the option `range` takes it.
    static std::string range_text(const HeatStatistics& statistics) {
        std::array<char, 64> text{};
        char* at = std::to_chars(text.data(), text.data() + 30, statistics.range_low).ptr;
        *at++ = ':';
        at = std::to_chars(at, text.data() + text.size(), statistics.range_high).ptr;
        return {text.data(), at};
    }

    const HeatOptions options_;
    const std::vector<Column> metrics_;
    const std::optional<Plan> uncounted_;
    std::vector<std::unique_ptr<std::uint32_t[]>> counts_;  ///< of each metric
    HeatStatistics statistics_;
};

/// Returns the options with defaults filled in, checked before a ray is traced.
Reply<HeatOptions> heat_options(const wire::Heatmap& message) {
    using protocol::word;
    HeatOptions options;
    options.metric = word(message.metric(), options.metric);
    options.palette = word(message.palette(), options.palette);
    options.scale = word(message.scale(), options.scale);
    options.range = word(message.range(), options.range);
    options.count = word(message.count(), options.count);
    constexpr std::array<std::uint32_t, 1> sample = {0};
    if (const auto dry = heat_statistics(sample, options); !dry)
        return refuse(Code::invalid_field, dry.error().message);
    return options;
}

}  // namespace

Reply<Answer> heatmap(const Services& services, const Caller& caller,
                      const protocol::Opened<wire::Heatmap>& message) {
    auto options = heat_options(*message.table);
    if (!options) return tl::unexpected(options.error());
    const std::string_view count = protocol::word(message->count(), "traversed");
    if (count != "traversed" && count != "necessary")
        return refuse(Code::invalid_field, "unknown count '" + std::string(count) +
                                               "': use one of traversed, necessary");
    auto plain = make_plan(services, caller, *message->job(), query_closest);
    if (!plain) return tl::unexpected(plain.error());
    const Column metric = *parse_column(options->metric);
    const SceneView& view = plain->scene.snapshot().view();
    const std::uint32_t levels = view.objects[view.root].levels;
    if (const auto known = check_level(metric, levels); !known)
        return refuse(Code::invalid_field, known.error().message);
    const std::string_view encode = protocol::word(message->encode(), "png");
    const bool by_level = metric.of_level() || encode == "exr";
    auto plan = Plan::with(*plain, query_closest, by_level ? counters_by_level : counters_total);
    if (!plan) return tl::unexpected(plan.error());
    std::vector<Column> metrics = metrics_of(*options, encode, levels);
    std::optional<Plan> uncounted;
    if (count == "necessary") uncounted = std::move(*plain);
    const std::uint64_t pixels = std::uint64_t{message->width()} * message->height();
    const Plan* others[] = {uncounted ? &*uncounted : &*plan};
    if (auto chosen = choose_backends(services.backends, pixels, *plan, others); !chosen)
        return tl::unexpected(chosen.error());
    if (uncounted) uncounted->worker = plan->worker;

    auto request = make_request(services, caller, std::move(*plan), message->camera(),
                                message->width(), message->height(), encode,
                                heat_bytes(message->width(), message->height(), metrics.size()));
    if (!request) return tl::unexpected(request.error());
    JobSubmission accepted = accept(request->plan, "heatmap", request->rays());
    accepted.advice = smaller_picture(request->encode);
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(
        caller,
        payload_bytes_max(request->width, request->height, request->encode, metrics.size()));
    accepted.job =
        std::make_unique<HeatmapJob>(services, caller, std::move(*request), std::move(*options),
                                     std::move(metrics), std::move(uncounted));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
