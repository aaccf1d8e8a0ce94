// EXPLAIN: the traversal of one ray as a tree, in a JSON document.
#include "engine/inspection/explanation.h"
#include "engine/integrators/camera.h"
#include "engine/integrators/generators.h"
#include "server/documents/explanation_json.h"
#include "server/execution/choose_backends.h"
#include "server/jobs/explain_job.h"
#include "server/jobs/ray_source.h"
#include "server/requests/request.h"
#include "server/requests/words/explain_request.h"
#include "server/requests/words/generator.h"
#include "server/requests/words/make_plan.h"

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::uint32_t default_steps = 256;

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
    if (const auto inside =
            check_pixel({message.pixel_x(), message.pixel_y()}, message.width(), message.height());
        !inside)
        return tl::unexpected(inside.error());
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

class TraversalJob final : public ExplainJob {
public:
    TraversalJob(const Services& services, const Caller& caller, Plan plan, const ChosenRay& chosen,
                 ExplanationContext context, std::uint32_t steps, Budget::Lease lease)
        : ExplainJob(services, caller, std::move(plan), chosen.camera, std::move(lease)),
          ray_(chosen.ray),
          context_(std::move(context)),
          steps_(steps) {
        context_.camera = camera_;
    }

private:
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
        const auto traced = plan_.backends.order[chunk.backend]->trace(plan_, call, nullptr, stop);
        if (!traced) return tl::unexpected(traced.error());
        JobStatistics::Counts counts;
        counts.rays = 1;
        counts.hits = hit.hit;
        counts.misses = 1 - counts.hits;
        finish(chunk, *traced, counts, explanation_json(plan_, context_, ray_, recorder.take()));
        return Frames{};
    }

    const Ray ray_;
    ExplanationContext context_;
    const std::uint32_t steps_;
};

}  // namespace

Reply<Answer> explain(const Services& services, const Caller& caller,
                      const protocol::Opened<wire::Explain>& message) {
    auto asked = make_plan(services, caller, job_words(*message->job()), query_closest);
    if (!asked) return tl::unexpected(asked.error());
    auto plan = Plan::observed(std::move(*asked));
    if (!plan) return tl::unexpected(plan.error());
    if (auto chosen = choose_backends(services.backends, 1, *plan); !chosen)
        return tl::unexpected(chosen.error());
    auto ray = choose_ray(*message.table, plan->scene.snapshot());
    if (!ray) return tl::unexpected(ray.error());

    const std::uint32_t steps = message->steps() == 0 ? default_steps : message->steps();
    constexpr std::string_view fewer = "ask for fewer steps";
    auto lease = reserve_explanation(services, caller, steps, fewer);
    if (!lease) return tl::unexpected(lease.error());
    ExplanationContext context{services.limits, {}, {}, 0, 0};
    if (!ray->camera.empty()) {
        context.pixel = {message->pixel_x(), message->pixel_y()};
        context.width = message->width();
        context.height = message->height();
    }
    JobSubmission accepted = accept_explanation(caller, *plan, lease->bytes(), fewer);
    accepted.job = std::make_unique<TraversalJob>(services, caller, std::move(*plan), *ray,
                                                  std::move(context), steps, std::move(*lease));
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
