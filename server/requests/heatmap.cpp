// HEATMAP: the cost of each pixel's ray, as raw counts or as a picture.
#include "engine/assets/image.h"
#include "engine/integrators/picture.h"
#include "server/requests/request.h"
#include "server/documents/heat_json.h"
#include "server/jobs/picture_job.h"
#include "server/documents/scene_info.h"
#include "server/documents/selection_text.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

/// Bytes per pixel: the count, a sorted copy for percentiles, the picture and the encoded file.
constexpr std::uint64_t pixel_bytes = 4 * sizeof(std::uint32_t);
/// The same for each channel of an EXR: the counts, differences as floats, interleaved, and the file
/// while it grows.
constexpr std::uint64_t channel_bytes = 6 * sizeof(std::uint32_t);

/// The answer's form: a file, or a document with the statistics of every metric, and perhaps the file
/// in it.
struct HeatForm {
    std::string file;  ///< png | exr | raw; empty: no file
    bool document = false;
    SelectionText selected;  ///< what the file or document says is hidden
    /// Counts every metric, in total and of each level.
    [[nodiscard]] bool all_metrics() const { return document || file == "exr"; }
};

/// Reads `encode`: png, exr, raw, json, or json+FILE.
Reply<HeatForm> read_form(std::string_view encode) {
    constexpr std::string_view prefix = "json";
    HeatForm form;
    form.document = encode.starts_with(prefix) &&
                    (encode.size() == prefix.size() || encode[prefix.size()] == '+');
    if (form.document) encode.remove_prefix(std::min(encode.size(), prefix.size() + 1));
    if (form.document && encode.empty()) return form;
    auto file = check_encode(encode);
    if (!file) return tl::unexpected(file.error());
    form.file = std::move(*file);
    return form;
}

/// Returns the bytes that a job holds. A narrow map is widened to the width of its legend.
std::uint64_t heat_bytes(std::uint32_t width, std::uint32_t height, const HeatForm& form,
                         std::size_t metrics) {
    const std::uint64_t pixels = std::uint64_t{std::max(width, heat_picture_width_min)} * height;
    std::uint64_t bytes = pixel_bytes;
    if (form.file == "exr")
        bytes += channel_bytes * metrics;
    else
        bytes += sizeof(std::uint32_t) * (metrics - 1);
    if (form.document) bytes *= 2;  // Base64, and the text that it becomes part of
    return bytes * pixels;
}

/// Returns what a map counts: every metric in total and of each level, or the one asked for.
std::vector<Column> metrics_of(const HeatOptions& options, const HeatForm& form,
                               std::uint32_t levels) {
    if (!form.all_metrics()) return {*parse_column(options.metric)};
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
std::uint64_t payload_bytes_max(std::uint32_t width, std::uint32_t height, const HeatForm& form,
                                std::size_t metrics) {
    std::uint64_t file = 0;
    if (form.file == "png")
        file = png_bytes_max(std::max(width, heat_picture_width_min),
                             height + heat_legend_height_max);
    else if (form.file == "exr")
        file = exr_bytes_max(width, height, static_cast<std::uint32_t>(metrics));
    else if (form.file == "raw")
        file = sizeof(std::uint32_t) * width * height;
    return form.document ? heat_json_bytes_max(metrics, file) : file;
}

/// Plans of one scene and its options.
struct HeatPlans {
    Plan counted;
    std::optional<Plan> uncounted;  ///< finds the hits; set only for count "necessary"
    [[nodiscard]] CastPlans cast() const {
        return {uncounted ? &*uncounted : nullptr, nullptr, &counted};
    }
};

class HeatmapJob final : public PictureJob {
public:
    /// `uncounted` is the plan that finds the hits; set only for count "necessary". `other` are the
    /// plans of a difference, whose counts are subtracted.
    HeatmapJob(const Services& services, const Caller& caller, PictureRequest asked, HeatForm form,
               HeatOptions options, std::vector<Column> metrics, std::optional<Plan> uncounted,
               std::optional<HeatPlans> other)
        : PictureJob(services, caller, std::move(asked)),
          form_(std::move(form)),
          options_(std::move(options)),
          metrics_(std::move(metrics)),
          uncounted_(std::move(uncounted)),
          other_(std::move(other)) {}

protected:
    void make_arrays() override {
        for (auto& counts : counts_) counts = blank<std::uint32_t>();
    }
    [[nodiscard]] bool needs_preparation() const override {
        return PictureJob::needs_preparation() || (other_ && other_->counted.selected != nullptr);
    }
    Reply<void> make_ready(const Stop& stop) override {
        if (auto ready = PictureJob::make_ready(stop); !ready) return ready;
        return other_ ? other_->counted.select() : Reply<void>();
    }
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

    Traced<std::uint64_t> trace_again(const PixelRange& pixels, std::size_t backend,
                                      const Stop& stop, TraceBuffers& buffers) override {
        if (!other_) return 0;
        const CastPlans by = other_->cast();
        ChunkCaster caster(by, backend, stop, buffers);
        std::vector<std::uint32_t> counts(pixels.count * metrics_.size());
        const auto seen = measure_work(pixels, other_->counted.source(services_.registry), caster,
                                       arrays_for(pixels, by, buffers), metrics_,
                                       by.closest != nullptr, counts);
        if (!seen) return tl::unexpected(caster.failure());
        for (std::size_t m = 0; m < metrics_.size(); ++m)
            for (std::size_t i = 0; i < pixels.count; ++i) {
                std::uint32_t& count = counts_[m][pixel_of(pixels.first + i)];
                count = difference(count, counts[m * pixels.count + i]);
            }
        return seen->rays;
    }

    Reply<Payload> encode() override {
        const Column metric = *parse_column(options_.metric);
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
    }

private:
    /// Returns a - b as the bits of an i32, at most 2^31 - 1 from zero.
    static std::uint32_t difference(std::uint32_t a, std::uint32_t b) {
        constexpr std::int64_t most = std::numeric_limits<std::int32_t>::max();
        return static_cast<std::uint32_t>(
            std::clamp(std::int64_t{a} - std::int64_t{b}, -most, most));
    }

    [[nodiscard]] std::span<const std::uint32_t> counts_of(const Column& metric) const {
        const auto at = std::find(metrics_.begin(), metrics_.end(), metric) - metrics_.begin();
        return {counts_[static_cast<std::size_t>(at)].get(), request().pixels()};
    }
    [[nodiscard]] std::span<const std::int32_t> differences_of(const Column& metric) const {
        const std::span<const std::uint32_t> bits = counts_of(metric);
        return {reinterpret_cast<const std::int32_t*>(bits.data()), bits.size()};
    }
    [[nodiscard]] Result<HeatStatistics> statistics_of(const Column& metric,
                                                       const HeatOptions& options) const {
        return other_ ? heat_statistics(differences_of(metric), options)
                      : heat_statistics(counts_of(metric), options);
    }

    [[nodiscard]] Result<Payload> encode_file(const Column& metric) const {
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
        auto file = encode_png(picture->width, picture->height, picture->rgba, heat_attributes());
        if (!file) return tl::unexpected(file.error());
        return Payload{picture->width, picture->height, std::move(*file)};
    }

    [[nodiscard]] Reply<Payload> encode_document(const Column& metric, const Payload& file) const {
        HeatDocument document{.plan = plan_,
                              .other = other_ ? &other_->counted : nullptr,
                              .options = options_,
                              .camera = request().camera.name,
                              .width = request().width,
                              .height = request().height,
                              .statistics = statistics_,
                              .histogram =
                                  other_ ? heat_histogram(differences_of(metric), statistics_)
                                         : heat_histogram(counts_of(metric), statistics_),
                              .rows = {},
                              .file = {form_.file, file.width, file.height, file.bytes},
                              .selected = form_.selected,
                              .limits = services_.limits};
        for (const Column& each : metrics_) {
            HeatOptions options;
            options.metric = column_name(each);
            const auto statistics = statistics_of(each, options);
            if (!statistics) return refuse(statistics.error());
            document.rows.push_back({options.metric, *statistics});
        }
        return json_payload(request().width, request().height, heat_json(document));
    }

    [[nodiscard]] Result<std::vector<std::byte>> encode_channels() const {
        std::vector<std::string> names;
        for (const Column& metric : metrics_) names.push_back(channel_name(metric));
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
        attributes.push_back({"raynest:range", range_text(statistics_)});
        add_selection(form_.selected, attributes);
        if (other_) {
            const Plan& other = other_->counted;
            const auto text = [&](const std::string& words) {
                return clean_text(words, services_.limits.name_bytes_max);
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
    const std::vector<Column> metrics_;
    const std::optional<Plan> uncounted_;
    const std::optional<HeatPlans> other_;
    /// The counts of each metric; of a difference the bits of an i32.
    std::vector<std::unique_ptr<std::uint32_t[]>> counts_{metrics_.size()};
    HeatStatistics statistics_;
};

/// Returns the options with defaults filled in, checked before a ray is traced.
Reply<HeatOptions> heat_options(const wire::Heatmap& message) {
    using protocol::word;
    HeatOptions options;
    const bool differs = message.other() != nullptr;
    options.metric = word(message.metric(), options.metric);
    options.palette = word(message.palette(), differs ? "diverging" : options.palette);
    options.scale = word(message.scale(), options.scale);
    options.range = word(message.range(), options.range);
    options.count = word(message.count(), options.count);
    constexpr std::array<std::uint32_t, 1> sample = {0};
    constexpr std::array<std::int32_t, 1> difference = {0};
    if (const auto dry = differs ? heat_statistics(difference, options)
                                 : heat_statistics(sample, options);
        !dry)
        return refuse(Code::invalid_field, dry.error().message);
    if (options.count != "traversed" && options.count != "necessary")
        return refuse(Code::invalid_field, "unknown count '" + options.count +
                                               "': use one of traversed, necessary");
    return options;
}

/// Makes the plans of a job, or of the other one of a difference.
Reply<HeatPlans> make_plans(const Services& services, const Caller& caller, const wire::Job& job,
                            CounterMode counters, bool necessary) {
    auto plain = make_plan(services, caller, job, query_closest);
    if (!plain) return tl::unexpected(plain.error());
    auto counted = Plan::with(*plain, query_closest, counters);
    if (!counted) return tl::unexpected(counted.error());
    HeatPlans plans{std::move(*counted), std::nullopt};
    if (necessary) plans.uncounted = std::move(*plain);
    return plans;
}

std::uint32_t levels_of(const Plan& plan) {
    const SceneView& view = plan.scene.snapshot().view();
    return view.objects[view.root].levels;
}

/// Returns a line that says what is subtracted from what.
std::string difference_note(const Plan& plan, const Plan& other) {
    const bool same_scene = plan.scene.name == other.scene.name;
    const auto words = [&](const Plan& of) {
        std::string text = "'" + of.scene.name + "'";
        if (same_scene && plan.scene.epoch != other.scene.epoch)
            text += " epoch " + std::to_string(of.scene.epoch);
        text += " with " + std::string(of.variant->name);
        const std::string settings = settings_text(of, false);
        if (!settings.empty()) text.append(" ").append(settings);
        if (plan.mask != other.mask) text += " mask " + mask_text(of.mask);
        return text;
    };
    return "the difference is the cost of " + words(plan) + " less that of " + words(other);
}

}  // namespace

Reply<Answer> heatmap(const Services& services, const Caller& caller,
                      const protocol::Opened<wire::Heatmap>& message) {
    auto options = heat_options(*message.table);
    if (!options) return tl::unexpected(options.error());
    auto form = read_form(protocol::word(message->encode(), "png"));
    if (!form) return tl::unexpected(form.error());
    const Column metric = *parse_column(options->metric);
    const CounterMode counters =
        metric.of_level() || form->all_metrics() ? counters_by_level : counters_total;
    const bool necessary = options->count == "necessary";
    auto plans = make_plans(services, caller, *message->job(), counters, necessary);
    if (!plans) return tl::unexpected(plans.error());
    Plan& plan = plans->counted;
    std::uint32_t levels = levels_of(plan);

    std::optional<HeatPlans> other;
    if (message->other() != nullptr) {
        auto made = make_plans(services, caller, *message->other(), counters, necessary);
        if (!made) return tl::unexpected(made.error());
        other = std::move(*made);
        if (plan.scene.snapshot().origin() != other->counted.scene.snapshot().origin())
            return refuse(Code::invalid_field,
                          "the scenes of the difference have other origins, so that no ray is the "
                          "same in both: load them with one `origin`");
        levels = std::max(levels, levels_of(other->counted));
        plan.notes.push_back(clean_text(difference_note(plan, other->counted),
                                        services.limits.text_bytes_max));
    }
    if (const auto known = check_level(metric, levels); !known)
        return refuse(Code::invalid_field, known.error().message);
    std::vector<Column> metrics = metrics_of(*options, *form, levels);

    form->selected = selection_text(protocol::present(message->job()));
    const std::uint32_t width = message->width(), height = message->height();
    std::vector<const Plan*> more;
    for (const HeatPlans* each : {&*plans, other ? &*other : nullptr}) {
        if (each == nullptr) continue;
        if (each != &*plans) more.push_back(&each->counted);
        if (each->uncounted) more.push_back(&*each->uncounted);
    }
    if (auto chosen = choose_backends(services.backends, std::uint64_t{width} * height, plan, more);
        !chosen)
        return tl::unexpected(chosen.error());
    if (plans->uncounted) plans->uncounted->worker = plan.worker;
    if (other) other->counted.worker = plan.worker;
    if (other && other->uncounted) other->uncounted->worker = plan.worker;

    const std::uint64_t bytes = heat_bytes(width, height, *form, metrics.size());
    auto request =
        form->document
            ? make_document_request(services, caller, std::move(plan), message->camera(), width,
                                    height, bytes, smaller_picture(form->file))
            : make_request(services, caller, std::move(plan), message->camera(), width, height,
                           form->file, bytes);
    if (!request) return tl::unexpected(request.error());
    JobSubmission accepted = accept(request->plan, "heatmap", request->rays() * (other ? 2 : 1));
    accepted.advice = smaller_picture(form->file);
    accepted.answer_bytes = accepted.result_bytes =
        payload_answer_bytes(caller, payload_bytes_max(width, height, *form, metrics.size()));
    accepted.job = std::make_unique<HeatmapJob>(
        services, caller, std::move(*request), std::move(*form), std::move(*options),
        std::move(metrics), std::move(plans->uncounted), std::move(other));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
