#include "server/requests/words/make_plan.h"

#include "engine/packs/registry.h"
#include "server/execution/kept_selections.h"
#include "server/ground/metrics.h"
#include "server/requests/words/at_moment.h"
#include "server/requests/words/idle_options.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"

#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

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

Reply<Settings> read_settings(const Variant& variant, const JobWords& job) {
    std::vector<std::pair<std::string, std::string>> assignments;
    for (const std::string& text : job.settings) {
        const auto equals = text.find('=');
        assignments.emplace_back(text.substr(0, equals), text.substr(equals + 1));
    }
    auto settings = parse_settings(variant, assignments, job.tables);
    if (!settings) return refuse(settings.error());
    return std::move(*settings);
}

/// Returns what a job hides, and memory for its view of the scene; null if it hides nothing.
Reply<std::shared_ptr<Selected>> reserve_selection(const Services& services, const Caller& caller,
                                                   const NamedScene& scene, SelectionWords words) {
    const SceneView& view = scene.snapshot().view();
    if (words.is_everything()) return nullptr;
    if (auto known = SelectedInstances::check(view, words.lists.selection()); !known)
        return refuse(Code::invalid_field, std::move(known.error().message));
    const std::uint64_t most = services.limits.hidden_instances_max;
    if (view.instance_count > most)
        return refuse(Code::limit_exceeded,
                      "the scene has more instances than hidden_instances_max = " +
                          std::to_string(most) + "; use masks (load --mask) to hide some of them");
    KeptSelections* const kept = services.selections;
    if (kept != nullptr) {
        if (auto known = kept->find(caller.principal, scene.held, words)) {
            services.metrics.count<&Metrics::selections_reused>(caller.principal);
            return known;
        }
    }
    const std::uint64_t bytes = Selected::least_bytes(view, words);
    auto lease = services.peers.reserve(bytes, caller.principal);
    if (!lease && kept != nullptr) {
        kept->drop(caller.principal);
        lease = services.peers.reserve(bytes, caller.principal);
    }
    if (!lease)
        return services.budget.refuse("hiding instances", bytes, caller.principal, "hide none");
    auto made = std::make_shared<Selected>(std::move(words), most, services.budget,
                                           caller.principal, std::move(*lease));
    if (kept != nullptr) kept->keep(caller.principal, scene.held, made);
    services.metrics.count<&Metrics::selections_made>(caller.principal);
    return made;
}

}  // namespace

Reply<Plan> make_plan(const Services& services, const Caller& caller, JobWords job, Query query,
                      CounterMode counters, bool lit, Posing posing) {
    const auto priority = parse_priority(job.priority);
    if (!priority) return tl::unexpected(priority.error());
    const auto traversal = parse_traversal(job.traversal);
    if (!traversal) return refuse_word(traversal.error());

    Plan plan;
    auto scene = services.scenes.find_to_read(job.scene, job.epoch, caller);
    if (!scene) return tl::unexpected(scene.error());
    if (posing == Posing::by_plan)
        scene = at_moment(services, caller, std::move(*scene), job.moment);
    if (!scene) return tl::unexpected(scene.error());
    plan.scene = std::move(*scene);
    plan.time = job.moment.time;
    plan.animation = job.moment.animation;
    std::string_view intersector = job.intersector;
    if (lit && intersector == "auto" && plan.scene.snapshot().view().blended_materials != 0 &&
        services.registry.find("alpha_blend") != nullptr)
        intersector = "alpha_blend";
    const auto variant = services.registry.choose(intersector, plan.scene.snapshot().view());
    if (!variant) return refuse(variant.error());
    plan.variant = *variant;
    auto settings = read_settings(*plan.variant, job);
    if (!settings) return tl::unexpected(settings.error());
    plan.settings = std::move(*settings);
    const bool skips_boxes = job.selection.skips_boxes;
    auto selected = reserve_selection(services, caller, plan.scene, std::move(job.selection));
    if (!selected) return tl::unexpected(selected.error());
    plan.selected = std::move(*selected);
    if (std::string note = idle_boxes_note(skips_boxes, plan.selected == nullptr); !note.empty())
        plan.notes.push_back(std::move(note));

    plan.traversal = *traversal;
    plan.mask = job.mask;
    plan.backends.asked = job.worker;
    plan.priority = *priority;
    plan.deadline_ms = job.deadline_ms;
    plan.detach = job.detach;
    return Plan::with(std::move(plan), query, counters);
}

}  // namespace raynest::server
