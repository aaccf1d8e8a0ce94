// BLAME: which instances, meshes and materials the rays of a picture spend their work on, as a JSON
// document.
#include "engine/inspection/blame.h"

#include "server/documents/blame_json.h"
#include "server/execution/choose_backends.h"
#include "server/jobs/picture_job.h"
#include "server/requests/request.h"
#include "server/requests/words/generator.h"
#include "server/requests/words/make_plan.h"
#include "server/requests/words/picture_request.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t default_top = 10;
/// Bytes of a row while it is counted: in the map of all rows, with its share of the buckets.
constexpr std::uint64_t row_bytes = 192;
/// Bytes of a row or finding of the document, at most.
constexpr std::uint64_t listed_row_bytes = 2048;
constexpr std::uint64_t head_bytes = 256 * 1024;

/// Returns the largest number of instances that rays can enter, counted by the ways to them, or
/// `most`. Each leads to a placement, and a placement lies in one instance per level.
std::uint64_t instances_by_way(const Snapshot& scene, std::uint64_t most) {
    const SceneStatistics& statistics = scene.statistics();
    return std::min(most, std::min(most, statistics.instances) * statistics.levels);
}

class BlameJob final : public PictureJob {
public:
    BlameJob(const Services& services, const Caller& caller, PictureRequest asked,
             std::uint32_t level, std::uint32_t top, std::size_t rows_max)
        : PictureJob(services, caller, std::move(asked)),
          rows_max_(rows_max),
          top_(top),
          blame_(plan_.scene.snapshot(), level, rows_max) {}

protected:
    [[nodiscard]] CastPlans plans() const override { return {nullptr, nullptr, nullptr, &plan_}; }
    std::optional<CameraHits> trace_pixels(const PixelRange& pixels, const ColumnSource& /*scene*/,
                                           RayCaster& caster, const PixelArrays& arrays) override {
        BlameCollector collector(blame_);
        const auto seen = watch_rays(pixels, caster, arrays, collector.observer());
        if (seen) collector.finish();
        return seen;
    }

    Reply<Payload> encode() override {
        if (blame_.overflowed())
            return refuse(Code::limit_exceeded,
                          "the rays enter more than blame_rows_max = " + std::to_string(rows_max_) +
                              " instances; group them by outer ones "
                              "with `level` 1, or look at less of the scene");
        return json_payload(request().width, request().height,
                            blame_json(plan_, blame_,
                                       {request().camera.name, request().width, request().height,
                                        top_, services_.limits}));
    }

private:
    const std::size_t rows_max_;
    const std::uint32_t top_;
    Blame blame_;
};

}  // namespace

Reply<Answer> blame(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Blame>& message) {
    auto asked = make_plan(services, caller, job_words(*message->job()), query_closest);
    if (!asked) return tl::unexpected(asked.error());
    auto plan = Plan::observed(std::move(*asked));
    if (!plan) return tl::unexpected(plan.error());
    const SceneView& view = plan->scene.snapshot().view();
    const std::uint32_t levels = view.objects[view.root].levels;
    if (message->level() >= std::max(levels, 1U) && message->level() != innermost_level)
        return refuse(Code::invalid_field,
                      "there is no level " + std::to_string(message->level()) + ": scene '" +
                          plan->scene.name + "' has " +
                          (levels == 1 ? "one tree and no instances"
                                       : "instances of levels 1 to " + std::to_string(levels - 1)));
    const std::uint64_t pixels = std::uint64_t{message->width()} * message->height();
    if (auto chosen = choose_backends(services.backends, pixels, *plan); !chosen)
        return tl::unexpected(chosen.error());

    const std::uint32_t top = message->top() == 0 ? default_top : message->top();
    const std::uint64_t most = services.limits.blame_rows_max;
    const std::uint64_t rows =
        std::min<std::uint64_t>(most, instances_by_way(plan->scene.snapshot(), most) +
                                          view.object_count + view.material_count + 1);
    const std::uint64_t document = head_bytes + 3 * std::uint64_t{top} * listed_row_bytes;
    auto request =
        make_document_request(services, caller, std::move(*plan), camera_request(message->camera()),
                              {{message->width(), message->height()}}, rows * row_bytes + document,
                              "group by an outer `level`");
    if (!request) return tl::unexpected(request.error());
    JobSubmission accepted = accept(request->plan, "blame", request->rays());
    accepted.advice = "ask for a smaller `top`";
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(caller, document);
    accepted.job = std::make_unique<BlameJob>(services, caller, std::move(*request),
                                              message->level(), top, rows);
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
