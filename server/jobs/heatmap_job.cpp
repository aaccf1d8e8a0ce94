#include "server/jobs/heatmap_job.h"

#include "engine/assets/images/image.h"
#include "protocol/text.h"
#include "server/documents/heat_json.h"
#include "server/documents/plan_text.h"
#include "server/jobs/services.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <limits>
#include <mutex>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

/// Pixels of a chunk whose rays are timed one by one, several times.
constexpr std::uint64_t timed_pixels_max = 4096;

/// Returns a channel's name: boxes, and L1.boxes of level 1.
std::string channel_name(const HeatMetric& metric) {
    const Column& counter = metric.counter;
    if (!counter.of_level()) return metric_name(metric);
    std::string name("L");
    return name.append(std::to_string(counter.level))
        .append(".")
        .append(field_info(counter.field).name);
}

/// Returns the counters among the metrics, which stand before the measures.
std::vector<Column> counters_of(std::span<const HeatMetric> metrics) {
    std::vector<Column> counters;
    for (const HeatMetric& metric : metrics)
        if (metric.measure == Measure::none) counters.push_back(metric.counter);
    return counters;
}

class HeatmapJob final : public PictureJob {
public:
    HeatmapJob(const Services& services, const Caller& caller, PictureRequest asked, HeatForm form,
               HeatOptions options, std::vector<HeatMetric> metrics, HeatPlans plans,
               std::optional<HeatPlans> other)
        : PictureJob(services, caller, std::move(asked)),
          form_(std::move(form)),
          options_(std::move(options)),
          metrics_(std::move(metrics)),
          counters_(counters_of(metrics_)),
          heat_plans_(std::move(plans)),
          other_(std::move(other)) {}

protected:
    void make_arrays() override {
        for (auto& counts : counts_) counts = blank<std::uint32_t>();
    }
    [[nodiscard]] const std::string& file_word() const override { return form_.file; }
    [[nodiscard]] bool needs_preparation() const override {
        return PictureJob::needs_preparation() || (other_ && other_->counted.needs_select());
    }
    Reply<void> make_ready(const Stop& stop) override {
        if (auto ready = PictureJob::make_ready(stop); !ready) return ready;
        return other_ ? other_->counted.select(stop) : Reply<void>();
    }
    [[nodiscard]] CastPlans plans() const override { return heat_plans_.cast(plan_); }
    std::uint64_t chunk_size(const Backend& backend, const Chunk& rest) const override {
        const std::uint64_t size = PictureJob::chunk_size(backend, rest);
        return heat_plans_.timed ? std::min(size, timed_pixels_max) : size;
    }
    std::optional<CameraHits> trace_pixels(const PixelRange& pixels, const ColumnSource& scene,
                                           RayCaster& caster, const PixelArrays& arrays) override {
        std::vector<std::uint32_t> counts(pixels.count * metrics_.size());
        const auto seen = measure(pixels, scene, caster, arrays, heat_plans_, counts);
        for (std::size_t m = 0; seen && m < metrics_.size(); ++m)
            place<std::uint32_t>(pixels.first,
                                 std::span(counts).subspan(m * pixels.count, pixels.count),
                                 counts_[m].get());
        return seen;
    }

    Traced<std::uint64_t> trace_again(const PixelRange& pixels, std::size_t backend,
                                      const Stop& stop, TraceBuffers& buffers) override {
        if (!other_) return 0;
        const CastPlans by = other_->cast();
        ChunkCaster caster(by, backend, stop, buffers);
        std::vector<std::uint32_t> counts(pixels.count * metrics_.size());
        const auto seen = measure(pixels, other_->counted.source(services_.registry), caster,
                                  arrays_for(pixels, by, buffers), *other_, counts);
        if (!seen) return tl::unexpected(caster.failure());
        for (std::size_t m = 0; m < metrics_.size(); ++m)
            for (std::size_t i = 0; i < pixels.count; ++i) {
                std::uint32_t& count = counts_[m][pixel_of(pixels.first + i)];
                count = difference(count, counts[m * pixels.count + i]);
            }
        return seen->rays;
    }

    Reply<Payload> encode() override {
        const HeatMetric metric = *parse_metric(options_.metric);
        const auto statistics = statistics_of(metric, options_);
        if (!statistics) return refuse(statistics.error());
        statistics_ = *statistics;

        Payload payload{request().width, request().height, {}};
        if (!form_.file.empty()) {
            auto file = encode_file(metric);
            if (!file) return refuse(file.error());
            payload = std::move(*file);
        }
        return form_.document ? encode_document(metric, payload) : Reply<Payload>(payload);
    }

    void complete(wire::DoneT& done) const override {
        done.heat = std::make_unique<wire::HeatStatisticsT>();
        done.heat->metric = options_.metric;
        // A difference below 0 travels as the u32 of the same bits.
        done.heat->min = static_cast<std::uint32_t>(statistics_.min);
        done.heat->mean = statistics_.mean;
        done.heat->p50 = static_cast<std::uint32_t>(statistics_.p50);
        done.heat->p90 = static_cast<std::uint32_t>(statistics_.p90);
        done.heat->p99 = static_cast<std::uint32_t>(statistics_.p99);
        done.heat->max = static_cast<std::uint32_t>(statistics_.max);
        done.heat->clipped = statistics_.clipped;
        done.heat->range_low = statistics_.range_low;
        done.heat->range_high = statistics_.range_high;
        done.heat->below = statistics_.below;
        done.heat->count = options_.count;
        if (heat_plans_.timed) done.notes.push_back(time_note());
    }

private:
    /// Counts what the counters ask for, and measures what the metrics behind them do.
    std::optional<CameraHits> measure(const PixelRange& pixels, const ColumnSource& scene,
                                      RayCaster& caster, const PixelArrays& arrays,
                                      const HeatPlans& plans, std::span<std::uint32_t> out) {
        std::optional<CameraHits> seen;
        if (!counters_.empty())
            seen = measure_work(pixels, scene, caster, arrays, counters_,
                                plans.uncounted.has_value(), out);
        if (!plans.timed || (!counters_.empty() && !seen)) return seen;
        double spread = 0;
        std::vector<std::uint32_t> times(pixels.count);
        std::vector<std::uint32_t> noises(pixels.count);
        seen = measure_time(pixels, caster, arrays, {times, noises}, spread);
        for (std::size_t m = counters_.size(); m < metrics_.size(); ++m)
            std::ranges::copy(metrics_[m].measure == Measure::time ? times : noises,
                              out.begin() + static_cast<std::ptrdiff_t>(m * pixels.count));
        const std::lock_guard lock(spread_mutex_);
        spread_ += spread * static_cast<double>(pixels.count);
        spread_pixels_ += pixels.count;
        return seen;
    }

    [[nodiscard]] std::string time_note() const {
        const std::lock_guard lock(spread_mutex_);
        const double spread =
            spread_ / static_cast<double>(std::max(spread_pixels_, std::uint64_t{1}));
        return fmt::format(
            "time is the median of {} runs of each ray on one thread; half of a ray's "
            "runs lie within {:.0f} % of it, in the mean",
            ray_time_runs, 100 * spread);
    }

    /// Returns a - b as the bits of an i32, at most 2^31 - 1 from zero.
    static std::uint32_t difference(std::uint32_t a, std::uint32_t b) {
        constexpr std::int64_t most = std::numeric_limits<std::int32_t>::max();
        return static_cast<std::uint32_t>(
            std::clamp(std::int64_t{a} - std::int64_t{b}, -most, most));
    }

    [[nodiscard]] std::span<const std::uint32_t> counts_of(const HeatMetric& metric) const {
        const auto at = std::find(metrics_.begin(), metrics_.end(), metric) - metrics_.begin();
        return {counts_[static_cast<std::size_t>(at)].get(), request().pixels()};
    }
    [[nodiscard]] std::span<const std::int32_t> differences_of(const HeatMetric& metric) const {
        const std::span<const std::uint32_t> bits = counts_of(metric);
        return {reinterpret_cast<const std::int32_t*>(bits.data()), bits.size()};
    }
    [[nodiscard]] Result<HeatStatistics> statistics_of(const HeatMetric& metric,
                                                       const HeatOptions& options) const {
        return other_ ? heat_statistics(differences_of(metric), options)
                      : heat_statistics(counts_of(metric), options);
    }

    [[nodiscard]] Result<Payload> encode_file(const HeatMetric& metric) const {
        Payload payload{request().width, request().height, {}};
        const std::span<const std::uint32_t> counts = counts_of(metric);
        if (form_.file == "raw") {
            payload.bytes.resize(counts.size_bytes());
            std::memcpy(payload.bytes.data(), counts.data(), payload.bytes.size());
            return payload;
        }
        if (form_.file == "exr") {
            auto file = encode_channels();
            if (!file) return tl::unexpected(file.error());
            payload.bytes = std::move(*file);
            return payload;
        }
        const auto picture =
            other_ ? heat_picture(payload.width, payload.height, differences_of(metric),
                                  statistics_, options_)
                   : heat_picture(payload.width, payload.height, counts, statistics_, options_);
        if (!picture) return tl::unexpected(picture.error());
        // In the order of an EXR's header: raynest merge draws the same file of parts.
        auto attributes = heat_attributes();
        std::ranges::sort(attributes, {}, &Attribute::name);
        auto file = encode_png(picture->width, picture->height, picture->rgba, attributes);
        if (!file) return tl::unexpected(file.error());
        return Payload{picture->width, picture->height, std::move(*file)};
    }

    [[nodiscard]] Reply<Payload> encode_document(const HeatMetric& metric,
                                                 const Payload& file) const {
        HeatDocument document{.plan = plan_,
                              .other = other_ ? &other_->counted : nullptr,
                              .options = options_,
                              .camera = request().camera.name,
                              .width = request().width,
                              .height = request().height,
                              .statistics = statistics_,
                              .histogram = other_
                                               ? heat_histogram(differences_of(metric), statistics_)
                                               : heat_histogram(counts_of(metric), statistics_),
                              .rows = {},
                              .file = {form_.file, file.width, file.height, file.bytes},
                              .selected = form_.selected,
                              .limits = services_.limits};
        for (const HeatMetric& each : metrics_) {
            HeatOptions options;
            options.metric = metric_name(each);
            const auto statistics = statistics_of(each, options);
            if (!statistics) return refuse(statistics.error());
            document.rows.push_back({options.metric, *statistics});
        }
        return json_payload(request().width, request().height, heat_json(document));
    }

    [[nodiscard]] Result<std::vector<std::byte>> encode_channels() const {
        std::vector<std::string> names;
        for (const HeatMetric& metric : metrics_) names.push_back(channel_name(metric));
        // EXR has no signed whole numbers.
        std::vector<std::vector<float>> signed_values;
        std::vector<Channel> channels;
        for (std::size_t m = 0; m < metrics_.size(); ++m) {
            if (other_) {
                const auto differences = differences_of(metrics_[m]);
                signed_values.emplace_back(differences.begin(), differences.end());
                channels.push_back({names[m], signed_values.back(), {}});
            } else {
                channels.push_back({names[m], {}, counts_of(metrics_[m])});
            }
        }
        return encode_exr(request().width, request().height, channels, heat_attributes());
    }

    /// Returns what made the map, for the header of its file.
    [[nodiscard]] std::vector<Attribute> heat_attributes() const {
        auto attributes = provenance();
        attributes.push_back({"raynest:metric", options_.metric});
        attributes.push_back({"raynest:count", options_.count});
        // A tile does not know the counts of the others: it says what was asked for.
        // And how the whole is drawn of all tiles.
        if (request().window.is_whole()) {
            attributes.push_back({"raynest:range", range_text(statistics_)});
        } else {
            attributes.push_back({"raynest:range_asked", options_.range});
            attributes.push_back({"raynest:palette", options_.palette});
            attributes.push_back({"raynest:scale", options_.scale});
            attributes.push_back(
                {"raynest:view", fmt::format("{}", fmt::join(options_.view, "\n"))});
        }
        add_selection(form_.selected, attributes);
        if (other_) {
            const Plan& other = other_->counted;
            const auto text = [&](const std::string& words) {
                return protocol::clean_text(words, services_.limits.name_bytes_max);
            };
            attributes.push_back({"raynest:other_scene", text(other.scene.name)});
            attributes.push_back({"raynest:other_hash", other.scene.snapshot().digest()});
            attributes.push_back({"raynest:other_epoch", std::to_string(other.scene.epoch)});
            attributes.push_back({"raynest:other_intersector", text(other.variant->name)});
            attributes.push_back({"raynest:other_settings", text(settings_text(other))});
            attributes.push_back({"raynest:other_mask", std::to_string(other.mask)});
        }
        return attributes;
    }

    /// Returns the range as the option `range` takes it.
    static std::string range_text(const HeatStatistics& statistics) {
        std::array<char, 64> text{};
        char* at = std::to_chars(text.data(), text.data() + 30, statistics.range_low).ptr;
        *at++ = ':';
        at = std::to_chars(at, text.data() + text.size(), statistics.range_high).ptr;
        return {text.data(), at};
    }

    const HeatForm form_;
    const HeatOptions options_;
    const std::vector<HeatMetric> metrics_;
    const std::vector<Column> counters_;
    const HeatPlans heat_plans_;
    const std::optional<HeatPlans> other_;
    /// The counts of each metric; of a difference the bits of an i32.
    std::vector<std::unique_ptr<std::uint32_t[]>> counts_{metrics_.size()};
    HeatStatistics statistics_;
    mutable std::mutex spread_mutex_;
    double spread_ = 0;  ///< RayCaster::timed()'s, times the pixels that it was measured for
    std::uint64_t spread_pixels_ = 0;
};

}  // namespace

std::unique_ptr<Job> heatmap_job(const Services& services, const Caller& caller,
                                 PictureRequest asked, HeatForm form, HeatOptions options,
                                 std::vector<HeatMetric> metrics, HeatPlans plans,
                                 std::optional<HeatPlans> other) {
    return std::make_unique<HeatmapJob>(services, caller, std::move(asked), std::move(form),
                                        std::move(options), std::move(metrics), std::move(plans),
                                        std::move(other));
}

}  // namespace raynest::server
