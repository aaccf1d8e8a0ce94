// HEATMAP: the cost of each pixel's ray, as raw counts or as a picture.
#include "engine/assets/image.h"
#include "engine/integrators/picture.h"
#include "server/handlers/handler.h"
#include "server/handlers/picture_job.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>

namespace raynest::server {
namespace {

/// Bytes per pixel: the count, a sorted copy for percentiles, the picture and the encoded file.
constexpr std::uint64_t pixel_bytes = 4 * sizeof(std::uint32_t);

/// Returns the bytes that a job holds. A narrow map is widened to the width of its legend.
std::uint64_t heat_bytes(std::uint32_t width, std::uint32_t height) {
    return pixel_bytes * std::max(width, heat_picture_width_min) * height;
}

/// Returns the maximum bytes of the payload.
std::uint64_t payload_bytes_max(std::uint32_t width, std::uint32_t height,
                                std::string_view encode) {
    if (encode == "png")
        return png_bytes_max(std::max(width, heat_picture_width_min),
                             height + heat_legend_height_max);
    if (encode == "exr") return exr_bytes_max(width, height, 1);
    return sizeof(std::uint32_t) * width * height;
}

class HeatmapJob final : public PictureJob {
public:
    /// `uncounted` is the plan that finds the hits; set only for count "necessary".
    HeatmapJob(const Services& services, const Caller& caller, PictureRequest asked,
               HeatOptions options, std::optional<Plan> uncounted)
        : PictureJob(services, caller, std::move(asked)),
          options_(std::move(options)),
          metric_(*parse_field(options_.metric)),
          uncounted_(std::move(uncounted)),
          counts_(blank<std::uint32_t>()) {}

protected:
    [[nodiscard]] CastPlans plans() const override {
        return {uncounted_ ? &*uncounted_ : nullptr, nullptr, &plan_};
    }
    std::optional<CameraHits> trace_pixels(const PixelRange& pixels, const ColumnSource& scene,
                                           RayCaster& caster, const PixelArrays& arrays) override {
        std::vector<std::uint32_t> counts(pixels.count);
        const auto seen =
            measure_work(pixels, scene, caster, arrays, metric_, uncounted_.has_value(), counts);
        if (seen) place<std::uint32_t>(pixels.first, counts, counts_.get());
        return seen;
    }

    Reply<Payload> encode() override {
        const std::span<const std::uint32_t> counts(counts_.get(), request().pixels());
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
            const std::array<Channel, 1> channels = {Channel{options_.metric, {}, counts}};
            auto file = encode_exr(payload.width, payload.height, channels);
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
    const HeatOptions options_;
    const Field metric_;
    const std::optional<Plan> uncounted_;
    const std::unique_ptr<std::uint32_t[]> counts_;
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
    auto plain = make_plan(services, caller, *message->job(), query_closest, false);
    if (!plain) return tl::unexpected(plain.error());
    auto plan = Plan::with(*plain, query_closest, true);
    if (!plan) return tl::unexpected(plan.error());
    std::optional<Plan> uncounted;
    if (count == "necessary") uncounted = std::move(*plain);
    const std::uint64_t pixels = std::uint64_t{message->width()} * message->height();
    const Plan* others[] = {uncounted ? &*uncounted : &*plan};
    if (auto chosen = choose_backends(services.backends, pixels, *plan, others); !chosen)
        return tl::unexpected(chosen.error());
    if (uncounted) uncounted->worker = plan->worker;

    auto request = make_request(
        services, caller, std::move(*plan), message->camera(), message->width(), message->height(),
        protocol::word(message->encode(), "png"), heat_bytes(message->width(), message->height()));
    if (!request) return tl::unexpected(request.error());
    JobSubmission accepted = accept(request->plan, "heatmap", request->rays());
    accepted.advice = smaller_picture(request->encode);
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(
        caller, payload_bytes_max(request->width, request->height, request->encode));
    accepted.job = std::make_unique<HeatmapJob>(services, caller, std::move(*request),
                                                std::move(*options), std::move(uncounted));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
