#include "server/execution/plan.h"

#include "engine/geometry/triangle.h"
#include "protocol/text.h"
#include "server/documents/scene_info.h"

#include <algorithm>
#include <limits>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

/// Largest trees that count as small: half a million triangles in leaf blocks, and as many bytes of
/// other primitives' records.
constexpr std::uint64_t small_trees_blocks = 1 << 16;
constexpr std::uint64_t small_trees_record_bytes = small_trees_blocks * sizeof(TriangleBlock);

/// Refuses an unknown word as INVALID_FIELD: the engine calls it a parameter, but on the wire it is
/// a field of the request.
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

Reply<Settings> read_settings(const Variant& variant, const wire::Job& job) {
    std::vector<std::pair<std::string, std::string>> assignments;
    for (const std::string& text : protocol::strings(job.settings())) {
        const auto equals = text.find('=');
        assignments.emplace_back(text.substr(0, equals), text.substr(equals + 1));
    }
    std::vector<NamedTable> tables;
    if (job.tables() != nullptr) {
        for (const wire::ParamTable* table : *job.tables()) {
            const auto values = protocol::values(*table);
            tables.push_back({std::string(protocol::text(table->name())),
                              {values.begin(), values.end()}});
        }
    }
    auto settings = parse_settings(variant, assignments, tables);
    if (!settings) return refuse(settings.error());
    return std::move(*settings);
}

/// Returns what a job hides, and memory for its view of the scene; null if it hides nothing.
Reply<std::shared_ptr<Plan::Selected>> reserve_selection(const Services& services,
                                                         const Caller& caller,
                                                         const SceneView& scene,
                                                         const wire::Job& job) {
    const auto list = [](const flatbuffers::Vector<std::uint32_t>* ids) {
        return ids == nullptr ? std::vector<std::uint32_t>()
                              : std::vector<std::uint32_t>(ids->begin(), ids->end());
    };
    InstanceLists lists{list(job.hidden_instances()), list(job.hidden_objects()),
                        list(job.only_instances()), list(job.only_objects())};
    if (lists.selection().is_everything()) return nullptr;
    if (auto known = SelectedInstances::check(scene, lists.selection()); !known)
        return refuse(Code::invalid_field, std::move(known.error().message));
    const std::uint64_t most = services.limits.hidden_instances_max;
    if (scene.instance_count > most)
        return refuse(Code::limit_exceeded,
                      "the scene has more instances than hidden_instances_max = " +
                          std::to_string(most) + "; use masks (load --mask) to hide some of them");
    const bool skips_boxes = job.skip_hidden_boxes();
    const std::uint64_t bytes =
        std::uint64_t{scene.instance_count} * sizeof(InstanceRecord) +
        (skips_boxes ? SelectedInstances::node_count(scene) * sizeof(Node) : 0);
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease)
        return services.budget.refuse("hiding instances", bytes, caller.principal, "hide none");
    return std::shared_ptr<Plan::Selected>(
        new Plan::Selected{std::move(lists), skips_boxes, std::move(*lease)});
}

RecordNormal record_normal(std::uint32_t type, const void* registry) {
    const PackPrimitive* primitive = static_cast<const Registry*>(registry)->find_primitive(type);
    return primitive == nullptr ? nullptr : primitive->normal;
}

}  // namespace

Reply<Plan> make_plan(const Services& services, const Caller& caller, const wire::Job& job,
                      Query query, CounterMode counters, bool lit) {
    using protocol::text;
    using protocol::word;
    const auto priority = parse_priority(word(job.priority(), "normal"));
    if (!priority) return tl::unexpected(priority.error());
    const auto traversal = parse_traversal(word(job.traversal(), "auto"));
    if (!traversal) return refuse_word(traversal.error());

    Plan plan;
    auto scene = services.scenes.find(text(job.scene()), job.epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    plan.scene = std::move(*scene);
    std::string_view intersector = word(job.intersector(), "auto");
    if (lit && intersector == "auto" && plan.scene.snapshot().view().blended_materials != 0 &&
        services.registry.find("alpha_blend") != nullptr)
        intersector = "alpha_blend";
    const auto variant = services.registry.choose(intersector, plan.scene.snapshot().view());
    if (!variant) return refuse(variant.error());
    plan.variant = *variant;
    auto settings = read_settings(*plan.variant, job);
    if (!settings) return tl::unexpected(settings.error());
    plan.settings = std::move(*settings);
    auto selected = reserve_selection(services, caller, plan.scene.snapshot().view(), job);
    if (!selected) return tl::unexpected(selected.error());
    plan.selected = std::move(*selected);

    plan.traversal = *traversal;
    plan.mask = job.mask();
    plan.worker.asked = word(job.worker(), "auto");
    plan.priority = *priority;
    plan.deadline_ms = job.deadline_ms();
    plan.detach = job.detach();
    return Plan::with(std::move(plan), query, counters);
}

Reply<Plan> Plan::with(Plan plan, Query query, CounterMode counters) {
    if (plan.selected != nullptr && counters != counters_none && plan.counters == counters_none)
        plan.notes.emplace_back(
            plan.selected->skips_boxes
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
    auto selector =
        KernelSelector::make(*plan.variant, query, plan.traversal, counters);
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

Reply<void> Plan::select() const {
    if (selected == nullptr) return {};
    const SceneView& view = scene.snapshot().view();
    auto instances = SelectedInstances::select(view, selected->lists.selection());
    if (!instances) return refuse(Code::invalid_field, std::move(instances.error().message));
    std::vector<Node> nodes;
    if (selected->skips_boxes) nodes = SelectedInstances::prune(view, *instances);
    selected->instances.emplace(view, std::move(*instances), std::move(nodes));
    return {};
}

TraceCall Plan::call() const {
    TraceCall call{};
    call.scene = selected ? &selected->instances->view() : &scene.snapshot().view();
    settings.apply_to(call);
    call.hits_max = hits_max;
    call.mask = mask;
    return call;
}

bool Plan::same_call(const Plan& other) const {
    return scene.held == other.scene.held && variant == other.variant &&
           settings == other.settings && query == other.query && traversal == other.traversal && mask == other.mask &&
           selected == other.selected && hits_max == other.hits_max;
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
    accepted.worker = plan.worker.first().name();
    accepted.rays = rays;
    accepted.detach = plan.detach;
    return accepted;
}

wire::StartedT started(const Plan& plan, const protocol::Limits& limits) {
    wire::StartedT message;
    message.scene = plan.scene.name;
    message.hash = plan.scene.snapshot().digest();
    message.epoch = plan.scene.epoch;
    message.intersector = clean_text(plan.variant->name, limits.name_bytes_max);
    message.target = plan.worker.first().target(plan);
    message.traversal = plan.untraced ? "none" : traversal_name(plan.traversal);
    message.worker = plan.worker.first().name();
    message.worker_reason = clean_text(plan.worker.reason, limits.text_bytes_max);
    message.notes = plan.notes;
    message.hidden = plan.hidden;
    const WorldPoint& origin = plan.scene.snapshot().origin();
    message.origin_x = origin[0];
    message.origin_y = origin[1];
    message.origin_z = origin[2];
    return message;
}

}  // namespace raynest::server
