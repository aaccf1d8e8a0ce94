#include "server/requests/words/make_plan.h"

#include "engine/packs/registry.h"
#include "protocol/control.h"
#include "protocol/text.h"
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
            tables.push_back(
                {std::string(protocol::text(table->name())), {values.begin(), values.end()}});
        }
    }
    auto settings = parse_settings(variant, assignments, tables);
    if (!settings) return refuse(settings.error());
    return std::move(*settings);
}

template <class T>
std::vector<T> list(const flatbuffers::Vector<T>* ids) {
    return ids == nullptr ? std::vector<T>() : std::vector<T>(ids->begin(), ids->end());
}

/// Returns what a job hides, and memory for its view of the scene; null if it hides nothing.
Reply<std::shared_ptr<Selected>> reserve_selection(const Services& services, const Caller& caller,
                                                   const NamedScene& scene, const wire::Job& job) {
    const SceneView& view = scene.snapshot().view();
    SelectionWords words{{list(job.hidden_instances()), list(job.hidden_objects()),
                          list(job.only_instances()), list(job.only_objects())},
                         {protocol::strings(job.hidden_paths()), list(job.hidden_path_ids())},
                         {protocol::strings(job.only_paths()), list(job.only_path_ids())},
                         job.skip_hidden_boxes()};
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

Reply<Plan> make_plan(const Services& services, const Caller& caller, const wire::Job& job,
                      Query query, CounterMode counters, bool lit, Posing posing) {
    using protocol::text;
    using protocol::word;
    const auto priority = parse_priority(word(job.priority(), "normal"));
    if (!priority) return tl::unexpected(priority.error());
    const auto traversal = parse_traversal(word(job.traversal(), "auto"));
    if (!traversal) return refuse_word(traversal.error());

    Plan plan;
    auto scene = services.scenes.find_to_read(text(job.scene()), job.epoch(), caller);
    if (!scene) return tl::unexpected(scene.error());
    if (posing == Posing::by_plan) scene = at_moment(services, caller, std::move(*scene), job);
    if (!scene) return tl::unexpected(scene.error());
    plan.scene = std::move(*scene);
    if (job.timed()) plan.time = job.time();
    plan.animation = text(job.animation());
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
    auto selected = reserve_selection(services, caller, plan.scene, job);
    if (!selected) return tl::unexpected(selected.error());
    plan.selected = std::move(*selected);
    if (std::string note = idle_options_note(job, plan.selected == nullptr); !note.empty())
        plan.notes.push_back(std::move(note));

    plan.traversal = *traversal;
    plan.mask = job.mask();
    plan.worker.asked = word(job.worker(), "auto");
    plan.priority = *priority;
    plan.deadline_ms = job.deadline_ms();
    plan.detach = job.detach();
    return Plan::with(std::move(plan), query, counters);
}

}  // namespace raynest::server
