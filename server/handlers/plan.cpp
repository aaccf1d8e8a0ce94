#include "server/handlers/plan.h"

#include "engine/geometry/triangle.h"
#include "server/handlers/scene_info.h"
#include "server/handlers/tracing.h"

#include <algorithm>
#include <array>
#include <utility>

namespace raynest::server {
namespace {

/// A chunk of the brute-force reference must stay short: others wait for its thread.
constexpr std::uint64_t reference_rays_max = 64;

/// Half a million triangles, or records of as many bytes as their blocks have.
constexpr std::uint64_t small_trees_blocks = 1 << 16;
constexpr std::uint64_t small_trees_record_bytes = small_trees_blocks * sizeof(TriangleBlock);

/// The engine reports unknown words as parameters; on the wire they are fields of the request.
tl::unexpected<protocol::Error> refuse_word(Error error) {
    return refuse(Code::invalid_field, std::move(error.message));
}

Reply<Priority> parse_priority(std::string_view word) {
    if (word == "low") return Priority::low;
    if (word == "normal") return Priority::normal;
    if (word == "high") return Priority::high;
    return refuse(Code::invalid_field,
                  "unknown priority '" + std::string(word) + "': use one of low, normal, high");
}

Reply<Settings> read_settings(const Variant& variant, const protocol::StringList* list) {
    std::vector<std::pair<std::string, std::string>> assignments;
    for (const std::string& text : protocol::strings(list)) {
        const auto equals = text.find('=');
        assignments.emplace_back(text.substr(0, equals), text.substr(equals + 1));
    }
    auto settings = parse_settings(variant, assignments);
    if (!settings) return refuse(settings.error());
    return std::move(*settings);
}

RecordNormal record_normal(std::uint32_t type, const void* registry) {
    const PackPrimitive* primitive = static_cast<const Registry*>(registry)->find_primitive(type);
    return primitive == nullptr ? nullptr : primitive->normal;
}

}  // namespace

Reply<Plan> make_plan(const Services& services, const Caller& caller, const wire::Job& job,
                      Query query, bool counting) {
    using protocol::text;
    using protocol::word;
    const auto priority = parse_priority(word(job.priority(), "normal"));
    if (!priority) return tl::unexpected(priority.error());
    const auto precision = parse_precision(word(job.precision(), "watertight"));
    if (!precision) return refuse_word(precision.error());
    const auto traversal = parse_traversal(word(job.traversal(), "auto"));
    if (!traversal) return refuse_word(traversal.error());

    Plan plan;
    auto scene = services.scenes.find(text(job.scene()), job.epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    plan.scene = std::move(*scene);
    const auto variant =
        services.registry.choose(word(job.intersector(), "auto"), plan.scene.snapshot().view());
    if (!variant) return refuse(variant.error());
    plan.variant = *variant;
    auto settings = read_settings(*plan.variant, job.settings());
    if (!settings) return tl::unexpected(settings.error());
    plan.settings = std::move(*settings);

    plan.query = query;
    plan.precision = *precision;
    plan.traversal = *traversal;
    plan.counting = counting;
    if (counting && plan.traversal != traversal_latency) {
        if (plan.traversal != traversal_auto)
            plan.notes.push_back(
                "counters are defined by the latency traversal: it ran instead of " +
                std::string(traversal_name(plan.traversal)));
        plan.traversal = traversal_latency;
    }
    auto tracer = Tracer::make(*plan.variant, query, plan.precision, plan.traversal, counting);
    if (!tracer) return refuse(tracer.error());
    plan.tracer = *tracer;
    plan.mask = job.mask();
    plan.worker.asked = word(job.worker(), "auto");
    plan.priority = *priority;
    plan.deadline_ms = job.deadline_ms();
    plan.chunk_time_max = std::chrono::milliseconds(services.limits.chunk_ms_max);
    plan.detach = job.detach();
    return plan;
}

TraceCall Plan::call() const {
    TraceCall call{};
    call.scene = &scene.snapshot().view();
    call.params = settings.params.empty() ? nullptr : settings.params.data();
    call.hits_max = hits_max;
    call.mask = mask;
    call.flags = settings.flags;
    return call;
}

bool Plan::same_call(const Plan& other) const {
    return scene.held == other.scene.held && variant == other.variant &&
           settings.params == other.settings.params && settings.flags == other.settings.flags &&
           query == other.query && traversal == other.traversal && precision == other.precision &&
           mask == other.mask && hits_max == other.hits_max;
}

std::uint64_t Plan::chunk_rays_max(const protocol::Limits& limits) const {
    return traversal == traversal_reference ? std::min(reference_rays_max, limits.chunk_rays_max)
                                            : limits.chunk_rays_max;
}

std::uint64_t Plan::cuda_rays_max(const protocol::Limits& limits) const {
    const std::uint64_t by_hits = hit_bytes_max / (sizeof(HitRecord) * hits_max);
    return std::min(by_hits, call_rays_max(limits));
}

bool Plan::has_small_trees() const {
    const SceneView& view = scene.snapshot().view();
    const ObjectRecord& last = view.objects[view.object_count - 1];
    return last.first_block + last.block_count <= small_trees_blocks &&
           last.first_record + records_bytes(last) <= small_trees_record_bytes;
}

ColumnSource Plan::source(const Registry& registry) const {
    ColumnSource source;
    source.scene = &scene.snapshot().view();
    source.paths = &scene.snapshot().paths();
    source.record_normal = record_normal;
    source.context = &registry;
    return source;
}

Accepted accept(const Plan& plan, const char* kind, std::uint64_t rays) {
    Accepted accepted;
    accepted.deadline_ms = plan.deadline_ms;
    accepted.priority = plan.priority;
    accepted.kind = kind;
    accepted.scene = plan.scene.name;
    accepted.worker = plan.worker.name();
    accepted.rays = rays;
    accepted.detach = plan.detach;
    return accepted;
}

wire::StartedT started(const Plan& plan, const protocol::Limits& limits) {
    wire::StartedT message;
    message.scene = plan.scene.name;
    message.hash = plan.scene.snapshot().hash();
    message.epoch = plan.scene.epoch;
    message.intersector = clean_text(plan.variant->name, limits.name_bytes_max);
    message.target = plan.worker.cuda != nullptr ? "cuda" : plan.variant->target;
    message.traversal = plan.untraced ? "none" : traversal_name(plan.traversal);
    message.precision = plan.precision == precision_fast ? "fast" : "watertight";
    message.worker = plan.worker.name();
    message.worker_reason = clean_text(plan.worker.reason, limits.text_bytes_max);
    message.notes = plan.notes;
    const WorldPoint& origin = plan.scene.snapshot().origin();
    message.origin_x = origin[0];
    message.origin_y = origin[1];
    message.origin_z = origin[2];
    return message;
}

Reply<void> check(TraceStatus status, const Plan& plan) {
    if (status == trace_ok) return {};
    if (status == trace_out_of_memory)
        return refuse(Code::resource_exhausted,
                      "the traversal of scene '" + plan.scene.name + "' ran out of memory");
    return refuse(Code::internal, "intersector '" + plan.variant->name + "' on target " +
                                      plan.variant->target + " refused its call");
}

}  // namespace raynest::server
