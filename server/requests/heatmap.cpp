// HEATMAP: the cost of each pixel's ray, as raw counts or as a picture.
#include "engine/assets/images/image.h"
#include "engine/integrators/picture.h"
#include "protocol/text.h"
#include "server/documents/heat_json.h"
#include "server/documents/plan_text.h"
#include "server/documents/scene_info.h"
#include "server/documents/selection_text.h"
#include "server/execution/choose_backends.h"
#include "server/jobs/heatmap_job.h"
#include "server/requests/request.h"
#include "server/requests/words/generator.h"
#include "server/requests/words/idle_options.h"
#include "server/requests/words/make_plan.h"
#include "server/requests/words/picture_request.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

/// Bytes per pixel: the count, a sorted copy for percentiles, the picture and the encoded file.
constexpr std::uint64_t pixel_bytes = 4 * sizeof(std::uint32_t);
/// The same for each channel of an EXR: the counts, differences as floats, interleaved, and the
/// file while it grows.
constexpr std::uint64_t channel_bytes = 6 * sizeof(std::uint32_t);

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

/// Returns what a map shows: every counter in total and of each level, and measures only if one was
/// asked for; or just what was asked for.
std::vector<HeatMetric> metrics_of(const HeatMetric& asked, const HeatForm& form,
                                   std::uint32_t levels) {
    if (!form.all_metrics()) return {asked};
    std::vector<HeatMetric> metrics;
    for (const FieldInfo& counter : counter_table()) {
        const Field field = *parse_field(counter.name);
        metrics.push_back({field});
        for (std::uint32_t level = 0; level < levels; ++level)
            metrics.push_back({Column(field, level)});
    }
    if (asked.measure != Measure::none) {
#define RAYNEST_MEASURE(name, title) metrics.push_back({{}, Measure::name});
#include "engine/integrators/measures.def"
    }
    return metrics;
}

/// Returns the maximum bytes of the payload.
std::uint64_t payload_bytes_max(std::uint32_t width, std::uint32_t height, const HeatForm& form,
                                std::size_t metrics) {
    std::uint64_t file = 0;
    if (form.file == "png")
        file =
            png_bytes_max(std::max(width, heat_picture_width_min), height + heat_legend_height_max);
    else if (form.file == "exr")
        file = exr_bytes_max(width, height, static_cast<std::uint32_t>(metrics));
    else if (form.file == "raw")
        file = sizeof(std::uint32_t) * width * height;
    return form.document ? heat_json_bytes_max(metrics, file) : file;
}

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
    if (const auto dry =
            differs ? heat_statistics(difference, options) : heat_statistics(sample, options);
        !dry)
        return refuse(Code::invalid_field, dry.error().message);
    if (options.count != "traversed" && options.count != "necessary")
        return refuse(Code::invalid_field,
                      "unknown count '" + options.count + "': use one of traversed, necessary");
    return options;
}

/// Makes the plans of a job, or of the other one of a difference.
Reply<HeatPlans> make_plans(const Services& services, const Caller& caller, JobWords job,
                            CounterMode counters, bool necessary, bool timed) {
    auto plain = make_plan(services, caller, std::move(job), query_closest);
    if (!plain) return tl::unexpected(plain.error());
    if (timed && plain->backends.asked == "auto") plain->backends.asked = "cpu";
    if (timed && plain->backends.asked != "cpu")
        return refuse(Code::invalid_field,
                      "the metric time is measured on the CPU alone: leave out `worker`");
    auto counted = Plan::with(*plain, query_closest, counters);
    if (!counted) return tl::unexpected(counted.error());
    HeatPlans plans{std::move(*counted)};
    if (timed) {
        Plan single = *plain;
        single.traversal = traversal_single;
        auto made = Plan::with(std::move(single), query_closest, counters_none);
        if (!made) return tl::unexpected(made.error());
        plans.timed = std::move(*made);
    }
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

/// The legend's words for the scene and the camera: "woods", "from (0, 1, 5) to (0, 0, 0)".
std::vector<std::string> view_words(const Plan& plan, const Plan* other, const Camera& camera,
                                    const CameraRequest& asked, std::size_t bytes_max) {
    const WorldPoint& origin = plan.scene.snapshot().origin();
    const int digits = origin == WorldPoint{} ? 6 : 9;
    const auto point = [&](const Vec3& at) {
        const std::array<float, 3> relative{at.x, at.y, at.z};
        std::string text;
        for (std::size_t axis = 0; axis < relative.size(); ++axis) {
            std::array<char, 32> number{};
            const auto end = std::to_chars(number.data(), number.data() + number.size(),
                                           static_cast<double>(relative[axis]) + origin[axis],
                                           std::chars_format::general, digits);
            text.append(axis == 0 ? "(" : ", ")
                .append(number.data(), static_cast<std::size_t>(end.ptr - number.data()));
        }
        return text + ")";
    };
    std::string scene = plan.scene.name;
    if (other != nullptr && other->scene.name != scene) scene += " less " + other->scene.name;
    const std::string place = asked.look_at ? "from " + point(asked.eye) + " to " + point(asked.at)
                                            : std::string("camera ").append(camera.name);
    return {protocol::clean_text(scene, bytes_max), protocol::clean_text(place, bytes_max)};
}

}  // namespace

Reply<Answer> heatmap(const Services& services, const Caller& caller,
                      const protocol::Opened<wire::Heatmap>& message) {
    auto options = heat_options(*message.table);
    if (!options) return tl::unexpected(options.error());
    auto form = read_form(protocol::word(message->encode(), "png"));
    if (!form) return tl::unexpected(form.error());
    const HeatMetric metric = *parse_metric(options->metric);
    const bool timed = metric.measure != Measure::none;
    if (timed && options->count == "necessary")
        return refuse(Code::invalid_field,
                      "`count` says which work counters count: leave it out of a map of time");
    const CounterMode counters =
        metric.counter.of_level() || form->all_metrics() ? counters_by_level : counters_total;
    const bool necessary = options->count == "necessary";
    JobWords job = job_words(*message->job());
    form->selected = selection_text(job.selection);
    auto plans = make_plans(services, caller, std::move(job), counters, necessary, timed);
    if (!plans) return tl::unexpected(plans.error());
    Plan& plan = plans->counted;
    std::uint32_t levels = levels_of(plan);

    std::optional<HeatPlans> other;
    if (message->other() != nullptr) {
        auto made =
            make_plans(services, caller, job_words(*message->other()), counters, necessary, timed);
        if (!made) return tl::unexpected(made.error());
        other = std::move(*made);
        if (plan.scene.snapshot().origin() != other->counted.scene.snapshot().origin())
            return refuse(Code::invalid_field,
                          "the scenes of the difference have other origins, so that no ray is the "
                          "same in both: load them with one `origin`");
        levels = std::max(levels, levels_of(other->counted));
        plan.notes.push_back(protocol::clean_text(difference_note(plan, other->counted),
                                                  services.limits.text_bytes_max));
    }
    if (const EditStatistics& edits = plan.scene.snapshot().statistics().edits;
        edits.refits + edits.rebuilds != 0 && !necessary)
        plan.notes.push_back(
            fmt::format("the scene {}: its trees, and so these counts, may differ from those of "
                        "the same content loaded afresh",
                        plan.time ? "is at a moment of its animation" : "was edited"));
    const AskedPixels pixels = asked_pixels(*message.table);
    if (std::string note =
            idle_colours_note(protocol::text(message->palette()), options->scale, form->file);
        !note.empty() && pixels.window.is_whole())  // of tiles a picture may be drawn
        plan.notes.push_back(std::move(note));
    if (const auto known = check_level(metric.counter, levels); !known)
        return refuse(Code::invalid_field, known.error().message);
    std::vector<HeatMetric> metrics = metrics_of(metric, *form, levels);

    const CameraRequest camera = camera_request(message->camera());
    const auto [width, height] = pixels.size();
    if (!pixels.window.is_whole() && (form->document || form->file == "png"))
        return refuse(Code::invalid_field,
                      "the legend and the document tell statistics of the whole map, which a tile "
                      "does not see: ask for encode exr or raw");
    std::vector<const Plan*> more;
    for (const HeatPlans* each : {&*plans, other ? &*other : nullptr}) {
        if (each == nullptr) continue;
        if (each != &*plans) more.push_back(&each->counted);
        if (each->uncounted) more.push_back(&*each->uncounted);
        if (each->timed) more.push_back(&*each->timed);
    }
    if (auto chosen = choose_backends(services.backends, std::uint64_t{width} * height, plan, more);
        !chosen)
        return tl::unexpected(chosen.error());
    for (HeatPlans* each : {&*plans, other ? &*other : nullptr}) {
        if (each == nullptr) continue;
        if (each != &*plans) each->counted.backends = plan.backends;
        if (each->uncounted) each->uncounted->backends = plan.backends;
        if (each->timed) each->timed->backends = plan.backends;
    }

    const std::uint64_t bytes = heat_bytes(width, height, *form, metrics.size());
    auto request =
        form->document
            ? make_document_request(services, caller, std::move(plan), camera, pixels, bytes,
                                    smaller_picture(form->file))
            : make_request(services, caller, std::move(plan), camera, pixels, form->file, bytes);
    if (!request) return tl::unexpected(request.error());
    options->view = view_words(request->plan, other ? &other->counted : nullptr, request->camera,
                               camera, services.limits.name_bytes_max);
    JobSubmission accepted = accept(request->plan, "heatmap", request->rays() * (other ? 2 : 1));
    accepted.advice = smaller_picture(form->file);
    accepted.answer_bytes = accepted.result_bytes =
        payload_answer_bytes(caller, payload_bytes_max(width, height, *form, metrics.size()));
    accepted.job =
        heatmap_job(services, caller, std::move(*request), std::move(*form), std::move(*options),
                    std::move(metrics), std::move(*plans), std::move(other));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
