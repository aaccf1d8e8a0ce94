// EXPLAIN: the traversal of one ray as a tree, in a JSON document.
#include "engine/inspection/explanation.h"
#include "engine/integrators/camera.h"
#include "engine/integrators/generators.h"
#include "server/execution/chunked_job.h"
#include "server/handlers/explanation_json.h"
#include "server/handlers/handler.h"
#include "server/handlers/payload.h"
#include "server/handlers/ray_source.h"
#include "server/handlers/scene_info.h"

#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t default_steps = 256;
/// Bytes of an entry of the tree, at most: in memory and as text, with names and a path.
constexpr std::uint64_t step_bytes = 3 * 1024;
/// Bytes of the document but for its entries, at most.
constexpr std::uint64_t head_bytes = 64 * 1024;

/// Returns why a ray is not valid; empty if it is.
std::string complaint(const Ray& ray) {
    if (is_valid(ray)) return {};
    if (ray.direction == Vec3(0)) return "its direction is zero";
    if (std::isfinite(ray.tmin) && ray.tmin < 0) return "tmin must not be negative";
    if (std::isfinite(ray.tmin) && ray.tmin > ray.tmax) return "tmin must not be above tmax";
    return "its numbers must be finite, but for tmax";
}

/// The ray to explain, and where it came from.
struct ChosenRay {
    Ray ray;
    std::string camera;  ///< empty: the ray itself was sent
};

Reply<ChosenRay> choose_ray(const wire::Explain& message, const Snapshot& scene) {
    ChosenRay chosen;
    if (message.origin() != nullptr && message.direction() != nullptr) {
        const auto vector = [](const wire::Vec3& v) { return Vec3(v.x(), v.y(), v.z()); };
        chosen.ray = {vector(*message.origin()), message.tmin(), vector(*message.direction()),
                      message.tmax()};
        if (message.tmax() == 0) chosen.ray.tmax = std::numeric_limits<float>::infinity();
        if (const std::string why = complaint(chosen.ray); !why.empty())
            return refuse(Code::invalid_field, "the ray is not valid: " + why);
        return chosen;
    }
    if (message.pixel_x() >= message.width() || message.pixel_y() >= message.height())
        return refuse(Code::invalid_field,
                      "pixel " + std::to_string(message.pixel_x()) + "," +
                          std::to_string(message.pixel_y()) + " lies outside of a picture of " +
                          std::to_string(message.width()) + "x" + std::to_string(message.height()) +
                          "; pixels count from 0,0, the upper left corner");
    auto camera = choose_camera(scene, camera_request(message.camera()));
    if (!camera) return refuse(Code::invalid_field, camera.error().message);
    const Sensor sensor = camera_sensor(*camera, {}, {message.width(), message.height()});
    generate_rays(sensor, std::uint64_t{message.pixel_y()} * message.width() + message.pixel_x(),
                  {&chosen.ray, 1});
    if (const std::string why = complaint(chosen.ray); !why.empty())
        return refuse(Code::invalid_field, "the pixel's ray is not valid: " + why);
    chosen.camera = camera->name;
    return chosen;
}

class ExplainJob final : public ChunkedJob {
public:
    ExplainJob(const Services& services, const Caller& caller, Plan plan, ChosenRay chosen,
               ExplanationContext context, std::uint32_t steps, Budget::Lease lease)
        : ChunkedJob(services, caller, std::move(plan), 1, false),
          ray_(chosen.ray),
          context_(std::move(context)),
          steps_(steps),
          lease_(std::move(lease)),
          payload_(services.limits, caller, "json") {
        context_.camera = clean_text(chosen.camera, services.limits.name_bytes_max);
        queue_.add(0, 1);
    }

    Frames greeting() override {
        wire::StartedT message = started(plan_, services_.limits);
        message.camera = context_.camera;
        Frames frames;
        frames.push_back(*protocol::encode(id_, message));
        return frames;
    }
    std::optional<Task> next() override {
        if (explained_) return payload_.next();
        if (auto work = next_work()) return std::move(work->task);
        return std::nullopt;
    }
    Reply<void> ended() override {
        if (explained_)
            payload_.ended();
        else
            explained_ = queue_.all_answered();
        return {};
    }
    [[nodiscard]] bool finished() const override { return explained_ && payload_.finished(); }
    [[nodiscard]] std::uint64_t held_bytes() const override { return lease_.bytes(); }
    Frames farewell() override {
        Frames frames;
        frames.push_back(*protocol::encode(id_, done()));
        return frames;
    }

private:
    [[nodiscard]] std::uint64_t chunk_size(const Backend& /*backend*/,
                                           const Chunk& /*rest*/) const override {
        return 1;
    }
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        ExplanationRecorder recorder(plan_.scene.snapshot(), steps_);
        HitRecord hit;
        TraceCall call = plan_.call();
        call.rays = &ray_;
        call.ray_count = 1;
        call.hits = &hit;
        call.observer = &recorder.observer();
        const std::vector<void*> outputs = buffers.resize_outputs(plan_, 1);
        call.outputs = outputs.empty() ? nullptr : outputs.data();
        const auto traced = plan_.worker.order[chunk.backend]->trace(plan_, call, nullptr, stop);
        if (!traced) return tl::unexpected(traced.error());
        payload_.set(json_payload(1, 1, explanation_json(plan_, context_, ray_, recorder.take())));
        JobStatistics::Counts counts;
        counts.rays = 1;
        counts.hits = hit.hit;
        counts.misses = 1 - counts.hits;
        statistics_.add(chunk.backend, *traced, counts);
        count_rays("explain", chunk, 1);
        queue_.answered(1);
        return Frames{};
    }

    const Ray ray_;
    ExplanationContext context_;
    const std::uint32_t steps_;
    const Budget::Lease lease_;
    PayloadSender payload_;
    bool explained_ = false;
};

}  // namespace

Reply<Answer> explain(const Services& services, const Caller& caller,
                      const protocol::Opened<wire::Explain>& message) {
    auto asked = make_plan(services, caller, *message->job(), query_closest);
    if (!asked) return tl::unexpected(asked.error());
    auto plan = Plan::observed(std::move(*asked));
    if (!plan) return tl::unexpected(plan.error());
    if (auto chosen = choose_backends(services.backends, 1, *plan); !chosen)
        return tl::unexpected(chosen.error());
    auto ray = choose_ray(*message.table, plan->scene.snapshot());
    if (!ray) return tl::unexpected(ray.error());

    const std::uint32_t steps = message->steps() == 0 ? default_steps : message->steps();
    const std::uint64_t bytes = head_bytes + steps * step_bytes;
    services.peers.make_memory(bytes, caller.principal);
    auto lease = services.budget.reserve(bytes);
    if (!lease)
        return refuse(Code::resource_exhausted,
                      "an explanation of " + std::to_string(steps) + " steps takes " +
                          protocol::bytes_text(bytes) +
                          ", more than is free of raynestd's --memory; ask for fewer steps");
    ExplanationContext context{services.limits, {}, {}, 0, 0};
    if (!ray->camera.empty()) {
        context.pixel = {message->pixel_x(), message->pixel_y()};
        context.width = message->width();
        context.height = message->height();
    }
    JobSubmission accepted = accept(*plan, "explain", 1);
    accepted.advice = "ask for fewer steps";
    accepted.answer_bytes = accepted.result_bytes = payload_answer_bytes(caller, bytes);
    accepted.job = std::make_unique<ExplainJob>(services, caller, std::move(*plan), std::move(*ray),
                                                std::move(context), steps, std::move(*lease));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
