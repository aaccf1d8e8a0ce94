// QUERY: traces rays as they arrive in QUERY_RAYS frames, or that a generator makes. Answers leave
// as CHUNKs of columns, or are summed by a reducer (reduce_job.h).
#include "engine/scene/edits/pose.h"
#include "protocol/text.h"
#include "server/documents/columns.h"
#include "server/execution/choose_backends.h"
#include "server/jobs/columns_job.h"
#include "server/jobs/reduce_job.h"
#include "server/requests/request.h"
#include "server/requests/words/generator.h"
#include "server/requests/words/make_plan.h"
#include "server/scheduling/peers.h"

#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

/// Default maximum hits per ray, for kinds multi and all.
constexpr std::uint32_t multi_hits = 8;
constexpr std::uint32_t all_hits = 4096;

/// The kind of a query. Kind `null` traces nothing: all rays of a closest query miss.
struct Kind {
    Query query = query_closest;
    bool untraced = false;
};

Reply<Kind> kind_of(std::string_view word) {
    if (word == "null") return Kind{query_closest, true};
    const auto query = parse_query(word);
    if (!query) return refuse(Code::invalid_field, query.error().message + ", null");
    return Kind{*query};
}

struct Reducer {
    std::string_view name, kind;
};
constexpr std::array reducers = {
#define RAYNEST_REDUCER(name, kind, rows, columns, text) Reducer{#name, #kind},
#include "protocol/lists/reducers.def"
};
const Reducer* find_reducer(std::string_view name) {
    const auto* found = std::find_if(reducers.begin(), reducers.end(),
                                     [&](const Reducer& each) { return each.name == name; });
    return found == reducers.end() ? nullptr : found;
}
/// Returns the kind of a query that names none: the cheapest that its reducer can use.
std::string_view default_kind(std::string_view reduce) {
    const Reducer* reducer = find_reducer(reduce);
    return reducer != nullptr ? reducer->kind : "closest";
}

/// Fails with INVALID_FIELD if the reducer is unknown, or the query names columns beside it.
Reply<void> check_reduce(const wire::Query& query) {
    const std::string_view reduce = protocol::text(query.reduce());
    if (reduce.empty()) return {};
    if (find_reducer(reduce) == nullptr) {
        std::string known;
        for (const Reducer& each : reducers)
            known += (known.empty() ? "" : ", ") + std::string(each.name);
        return refuse(Code::invalid_field,
                      "unknown reduce '" + std::string(reduce) + "': use one of " + known);
    }
    if (query.fields() != nullptr && query.fields()->size() != 0)
        return refuse(Code::invalid_field,
                      "reduce " + std::string(reduce) + " has columns of its own; name no fields");
    return {};
}

/// Fails with INVALID_FIELD if a name that only the client needs is none of the query's columns: Started
/// repeats these names.
Reply<void> check_hidden(std::span<const std::string> hidden, std::span<const std::string> fields) {
    for (auto name = hidden.begin(); name != hidden.end(); ++name)
        if (std::ranges::find(fields, *name) == fields.end() ||
            std::find(hidden.begin(), name, *name) != name)
            return refuse(Code::invalid_field, "hidden: '" + protocol::clean_text(*name, 64) +
                                                   "' must be one of fields, and there once");
    return {};
}

/// Has the scene move while its sweep is measured, if it has an animation. The CPU traces it: each
/// step is another scene, and a GPU would be sent each.
Reply<void> set_motion(Plan& plan, RaySource& source, const Services& services) {
    const std::string cpu(services.backends.back()->name());
    if (plan.backends.asked != "auto" && plan.backends.asked != cpu)
        return refuse(Code::invalid_field, "worker " + plan.backends.asked +
                                               ": a scene that moves meanwhile (step_error) is "
                                               "traced by worker " +
                                               cpu);
    plan.backends.asked = cpu;
    MovingScene motion;
    const Snapshot& scene = plan.scene.snapshot();
    if (plan.time || !plan.animation.empty() || !animations_of(scene, 1).empty()) {
        const auto moment = find_moment(scene, plan.animation, plan.time.value_or(0));
        if (!moment) return refuse(moment.error());
        motion.scene.emplace(SceneMotion{moment->animation, std::nullopt});
        if (plan.time) motion.scene->seconds = *plan.time;
    }
    source.set_motion(motion);
    return {};
}

}  // namespace

Reply<Answer> query(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Query>& message) {
    const std::string_view reduce = protocol::text(message->reduce());
    if (const auto known = check_reduce(*message.table); !known)
        return tl::unexpected(known.error());
    const auto kind = kind_of(protocol::word(message->kind(), default_kind(reduce)));
    if (!kind) return tl::unexpected(kind.error());
    auto columns = Columns::choose(protocol::strings(message->fields()), kind->query);
    if (!columns) return tl::unexpected(columns.error());
    const bool moves = moves_scene(message->generator());
    auto plan = make_plan(services, caller, job_words(*message->job()), kind->query,
                          columns->counters(), false, moves ? Posing::by_job : Posing::by_plan);
    if (!plan) return tl::unexpected(plan.error());
    if (auto known = columns->check_levels(plan->scene.snapshot().view()); !known)
        return tl::unexpected(known.error());
    plan->untraced = kind->untraced;
    plan->hidden = protocol::strings(message->hidden());
    if (auto known = check_hidden(plan->hidden, protocol::strings(message->fields())); !known)
        return tl::unexpected(known.error());
    plan->reads_rays = reduce.empty() && columns->read_rays();
    if (plan->csr()) plan->hits_max = message->max_hits();
    if (plan->hits_max == 0) plan->hits_max = kind->query == query_all ? all_hits : multi_hits;
    auto source = read_rays(*message.table, plan->scene.snapshot());
    if (!source) return tl::unexpected(source.error());
    if (moves)
        if (auto set = set_motion(*plan, *source, services); !set)
            return tl::unexpected(set.error());
    if (source->rays() > services.limits.rays_max)
        return refuse(Code::limit_exceeded, "a query of " + std::to_string(source->rays()) +
                                                " rays, the limit is rays_max = " +
                                                std::to_string(services.limits.rays_max));
    if (auto chosen = choose_backends(services.backends, source->rays(), *plan); !chosen)
        return tl::unexpected(chosen.error());

    JobSubmission accepted = accept(*plan, "query", source->rays());
    SentSweep* sweep = source->sweep();
    if (sweep != nullptr) {
        const std::uint64_t bytes = sweep->order().held_bytes();
        auto lease = services.peers.reserve(bytes, caller.principal);
        if (!lease)
            return services.budget.refuse("the poses of the sweep", bytes, caller.principal,
                                          "ask for fewer scans at a time");
        sweep->begin(std::move(*lease));
    }
    accepted.detail =
        reduce.empty() ? protocol::word(message->kind(), default_kind(reduce)) : reduce;
    // Assume the worst case, a frame per ray, with its mask.
    accepted.input_bytes = sweep != nullptr ? sweep->order().sent_bytes()
                                            : 2 * protocol::alignment * message->ray_count();
    auto job = reduce.empty()
                   ? columns_job(services, caller, std::move(*plan), std::move(*source),
                                 std::move(*columns))
                   : reduce_job(services, caller, std::move(*plan), std::move(*source), reduce);
    if (!job) return tl::unexpected(job.error());
    accepted.result_bytes = (*job)->result_bytes();
    accepted.answer_bytes =
        kind->query == query_all ? services.limits.window_bytes : accepted.result_bytes;
    accepted.job = std::move(*job);
    return Answer{std::move(accepted)};
}

}  // namespace raynest::server
