// What query, render and heat map have in common: the words of a wire::Job become one compiled
// function and a call to fill in per chunk. Decided once per job, never per ray.
#pragma once

#include "engine/packs/tracer.h"
#include "engine/queries/columns.h"
#include "server/handlers/handler.h"
#include "server/handlers/worker_choice.h"

#include <chrono>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

struct Plan {
    NamedScene scene;
    const Variant* variant = nullptr;
    Settings settings;
    Query query = query_closest;
    Traversal traversal = traversal_auto;  ///< as asked; what each chunk went through, Tally knows
    Precision precision = precision_watertight;
    Tracer tracer;
    bool counting = false;
    bool untraced = false;   ///< kind null: every answer is the canonical miss
    bool reads_rays = true;  ///< what becomes of the answers looks at the rays, too
    std::uint32_t mask = 0xFFFFFFFFU;
    std::uint32_t hits_max = 1;   ///< of `all`: the budget of a ray
    std::uint64_t hits_room = 0;  ///< of `all`: records that one call of the kernel may fill
    Priority priority = Priority::normal;
    std::uint32_t deadline_ms = 0;
    std::chrono::milliseconds chunk_time_max{};
    bool detach = false;
    std::vector<std::string> notes;  ///< for the user, sent with STARTED
    WorkerChoice worker;

    /// Has a ray any number of hits, so that answers need splits?
    [[nodiscard]] bool csr() const { return query == query_multi || query == query_all; }
    /// Everything of a call but the rays and where the answers go.
    [[nodiscard]] TraceCall call() const;
    /// Does it make the same call, so that one of it may serve both?
    [[nodiscard]] bool same_call(const Plan& other) const;
    /// May the io thread trace a ray? None is interrupted within a tree, and of one that is not
    /// small it takes milliseconds to meet all.
    [[nodiscard]] bool has_small_trees() const;
    /// Rays that one task may trace at most: a chunk, or few where a ray walks the whole scene.
    [[nodiscard]] std::uint64_t chunk_rays_max(const protocol::Limits& limits) const;
    /// The same of a task whose rays a GPU traces.
    [[nodiscard]] std::uint64_t cuda_rays_max(const protocol::Limits& limits) const;
    /// Does a GPU trace what fell back for this reason, or, if empty, did not?
    [[nodiscard]] bool on_cuda(const std::string& fallback) const {
        return worker.cuda != nullptr && fallback.empty();
    }
    /// Where columns come from; the caller adds rays and hits.
    [[nodiscard]] ColumnSource source(const Registry& registry) const;
};

/// Looks everything up; the error names the word that is wrong. `counting` forces the latency
/// traversal on the CPU, and a note says so.
Reply<Plan> make_plan(const Services& services, const Caller& caller, const wire::Job& job,
                      Query query, bool counting);

/// What a handler hands over for this plan, but for the job itself.
[[nodiscard]] Accepted accept(const Plan& plan, const char* kind, std::uint64_t rays);

/// STARTED, as far as the plan knows it.
[[nodiscard]] wire::StartedT started(const Plan& plan, const protocol::Limits& limits);

/// What a kernel gave back, as an error of the job.
Reply<void> check(TraceStatus status, const Plan& plan);

}  // namespace raynest::server
