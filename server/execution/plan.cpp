#include "server/execution/plan.h"

#include "engine/geometry/triangle.h"
#include "engine/packs/registry.h"
#include "protocol/text.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace raynest::server {
namespace {

/// Largest trees that count as small: half a million triangles in leaf blocks, and as many bytes of
/// other primitives' records.
constexpr std::uint64_t small_trees_blocks = 1 << 16;
constexpr std::uint64_t small_trees_record_bytes = small_trees_blocks * sizeof(TriangleBlock);

RecordNormal record_normal(std::uint32_t type, const void* registry) {
    const PackPrimitive* primitive = static_cast<const Registry*>(registry)->find_primitive(type);
    return primitive == nullptr ? nullptr : primitive->normal;
}

}  // namespace

Reply<Plan> Plan::with(Plan plan, Query query, CounterMode counters) {
    if (plan.selected != nullptr && counters != counters_none && plan.counters == counters_none)
        plan.notes.emplace_back(
            plan.selected->skips_boxes()
                ? "boxes that lead to hidden instances alone are left out of the counts"
                : "boxes of hidden instances are tested and counted; `skip_hidden_boxes` leaves "
                  "them out");
    plan.query = query;
    plan.counters = counters;
    if (counters != counters_none && plan.traversal != traversal_single) {
        if (plan.traversal != traversal_auto)
            plan.notes.push_back(
                "counters are defined by the single traversal: it ran instead of " +
                std::string(traversal_name(plan.traversal)));
        plan.traversal = traversal_single;
    }
    auto selector = KernelSelector::make(*plan.variant, query, plan.traversal, counters);
    if (!selector) return refuse(selector.error());
    plan.selector = *selector;
    return plan;
}

Reply<Plan> Plan::observed(Plan plan) {
    auto counted = with(std::move(plan), query_closest, counters_total);
    if (!counted) return counted;
    auto selector = KernelSelector::observing(*counted->variant);
    if (!selector) return refuse(selector.error());
    counted->selector = *selector;
    return counted;
}

Reply<void> Plan::select(const Stop& stop) const {
    return selected == nullptr ? Reply<void>() : selected->make(scene.snapshot(), stop);
}

TraceCall Plan::call() const {
    TraceCall call{};
    call.scene = &view();
    settings.apply_to(call);
    call.hits_max = hits_max;
    call.mask = mask;
    return call;
}

bool Plan::same_call(const Plan& other) const {
    return scene.held == other.scene.held && variant == other.variant &&
           settings == other.settings && query == other.query && traversal == other.traversal &&
           mask == other.mask && selected == other.selected && hits_max == other.hits_max;
}

std::uint64_t Plan::hit_rays_max() const {
    if (query == query_all) return std::numeric_limits<std::uint64_t>::max();
    const std::uint64_t most_bytes =
        std::max<std::uint64_t>(sizeof(HitRecord) * hits_max, sizeof(Counters) * counter_sets());
    return std::max<std::uint64_t>(1, hit_bytes_max / most_bytes);
}

std::uint32_t Plan::counter_sets() const {
    const SceneView& view = scene.snapshot().view();
    return counters == counters_by_level ? view.objects[view.root].levels
                                         : static_cast<std::uint32_t>(counters);
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
    source.shading = scene.snapshot().shading().geometries;
    source.record_normal = record_normal;
    source.context = &registry;
    return source;
}

JobSubmission accept(const Plan& plan, const char* kind, std::uint64_t rays) {
    JobSubmission accepted;
    accepted.deadline_ms = plan.deadline_ms;
    accepted.priority = plan.priority;
    accepted.kind = kind;
    accepted.scene = plan.scene.name;
    accepted.worker = plan.backends.first().name();
    accepted.rays = rays;
    accepted.detach = plan.detach;
    return accepted;
}

wire::StartedT started(const Plan& plan, const protocol::Limits& limits) {
    wire::StartedT message;
    message.scene = plan.scene.name;
    message.hash = plan.scene.snapshot().digest();
    message.epoch = plan.scene.epoch;
    message.intersector = protocol::clean_text(plan.variant->name, limits.name_bytes_max);
    message.target = plan.backends.first().target(plan);
    message.traversal = plan.untraced ? "none" : traversal_name(plan.traversal);
    message.worker = plan.backends.first().name();
    message.worker_reason = protocol::clean_text(plan.backends.reason, limits.text_bytes_max);
    message.notes = plan.notes;
    message.hidden = plan.hidden;
    const WorldPoint& origin = plan.scene.snapshot().origin();
    message.origin_x = origin[0];
    message.origin_y = origin[1];
    message.origin_z = origin[2];
    return message;
}

}  // namespace raynest::server
