// The description of what a job traces, and how: the words of a wire::Job become compiled functions and a call to fill
// in per chunk. Decided once per job, never per ray; nothing changes a plan once its job runs.
#pragma once

#include "engine/packs/kernel_selector.h"
#include "engine/queries/columns.h"
#include "server/backends/backends.h"
#include "server/handlers/handler.h"

#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

struct Plan {
    NamedScene scene;
    const Variant* variant = nullptr;
    Settings settings;
    Query query = query_closest;
    Traversal traversal = traversal_auto;  ///< as asked; JobStatistics knows what chunks used
    Precision precision = precision_watertight;
    KernelSelector selector;
    bool counting = false;
    bool untraced = false;   ///< kind null: every answer is the canonical miss
    bool reads_rays = true;  ///< what becomes of the answers looks at the rays, too
    std::uint32_t mask = 0xFFFFFFFFU;
    std::uint32_t hits_max = 1;   ///< of `all`: the budget of a ray
    std::uint64_t hits_room = 0;  ///< of `all`: records that one call of the kernel may fill
    Priority priority = Priority::normal;
    std::uint32_t deadline_ms = 0;
    bool detach = false;
    std::vector<std::string> notes;   ///< for the user, sent with STARTED
    std::vector<std::string> hidden;  ///< columns that only the client needs, sent with STARTED
    BackendChoice worker;

    /// Has a ray any number of hits, so that answers need splits?
    [[nodiscard]] bool csr() const { return query == query_multi || query == query_all; }
    /// Everything of a call but the rays and where the answers go.
    [[nodiscard]] TraceCall call() const;
    /// Does it make the same call, so that one of it may serve both?
    [[nodiscard]] bool same_call(const Plan& other) const;
    /// May the io thread trace a ray? None is interrupted within a tree, and of one that is not
    /// small it takes milliseconds to meet all.
    [[nodiscard]] bool has_small_trees() const;
    /// Rays whose hits fit hit_bytes_max; of `all` any number.
    [[nodiscard]] std::uint64_t hit_rays_max() const;
    /// Are its rays traced on the daemon's own compute threads, if nothing goes wrong?
    [[nodiscard]] bool is_local() const { return worker.first().pool() == nullptr; }
    /// A plan for the same rays by another function: for integrators that ask several questions.
    [[nodiscard]] static Reply<Plan> with(Plan plan, Query query, bool counting);
    /// Where columns come from; the caller adds rays and hits.
    [[nodiscard]] ColumnSource source(const Registry& registry) const;
};

/// The hit records of a chunk fit into this; it bounds the rays of a chunk where a ray has many
/// hits.
inline constexpr std::uint64_t hit_bytes_max = 8ULL << 20;

/// Looks everything up; the error names the word that is wrong. `counting` forces the single
/// traversal on the CPU, and a note says so.
Reply<Plan> make_plan(const Services& services, const Caller& caller, const wire::Job& job,
                      Query query, bool counting);

/// The submission of a job with this plan, but for the job itself.
[[nodiscard]] JobSubmission accept(const Plan& plan, const char* kind, std::uint64_t rays);

/// STARTED, as far as the plan knows it.
[[nodiscard]] wire::StartedT started(const Plan& plan, const protocol::Limits& limits);

}  // namespace raynest::server
