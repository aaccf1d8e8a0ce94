// A plan says what a job traces and how: compiled functions and the arguments of their calls. It is
// made once per job and does not change while the job runs.
#pragma once

#include "engine/packs/kernel_selector.h"
#include "engine/queries/columns.h"
#include "protocol/wire.h"
#include "server/execution/backend.h"
#include "server/execution/selected.h"
#include "server/ground/stop.h"
#include "server/scheduling/job.h"
#include "server/store/named_scene.h"

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

struct Plan {
    NamedScene scene;
    std::optional<double> time;  ///< the scene's moment of its animation; nothing: none
    std::string animation;       ///< its name or number; empty: the first
    const Variant* variant = nullptr;
    Settings settings;
    Query query = query_closest;
    Traversal traversal = traversal_auto;  ///< as requested; JobStatistics has those that ran
    KernelSelector selector;
    CounterMode counters = counters_none;
    bool untraced = false;   ///< kind null: every answer is the canonical miss
    bool reads_rays = true;  ///< columns or reducers read the rays besides the hits
    std::uint32_t mask = 0xFFFFFFFFU;
    std::shared_ptr<Selected> selected;  ///< null: no instance is hidden
    std::uint32_t hits_max = 1;          ///< maximum hits per ray
    std::uint64_t hits_room = 0;         ///< kind all: maximum hit records per call of the kernel
    Priority priority = Priority::normal;
    std::uint32_t deadline_ms = 0;
    bool detach = false;
    std::vector<std::string> notes;   ///< for the user, sent with STARTED
    std::vector<std::string> hidden;  ///< columns that only the client needs, sent with STARTED
    BackendChoice backends;

    /// True if the number of hits per ray varies, so that answers need splits.
    [[nodiscard]] bool csr() const { return query == query_multi || query == query_all; }
    /// True if select() has something to do.
    [[nodiscard]] bool needs_select() const { return selected != nullptr && !selected->is_made(); }
    /// Makes the view of `selected`, if there is one, for all copies of this plan. Call it in a
    /// task, before call(). Fails as Selected::make() does.
    Reply<void> select(const Stop& stop) const;
    /// Returns a call without rays and output buffers.
    [[nodiscard]] TraceCall call() const;
    /// True if call() is the same for both plans, so that one call can trace rays of both.
    [[nodiscard]] bool same_call(const Plan& other) const;
    /// True if the io thread may trace a ray of this plan. A ray cannot be interrupted within a
    /// tree, and one that meets all of a large tree takes milliseconds.
    [[nodiscard]] bool has_small_trees() const;
    /// Counters per ray: none, one, or one for each level of the scene.
    [[nodiscard]] std::uint32_t counter_sets() const;
    /// Maximum number of rays whose hits and counters fit hit_bytes_max; unbounded for kind all.
    [[nodiscard]] std::uint64_t hit_rays_max() const;
    /// True if the first backend traces on the daemon's own compute threads.
    [[nodiscard]] bool is_local() const { return backends.first().pool() == nullptr; }
    /// Returns a copy of `plan` with another query, for integrators that make several.
    [[nodiscard]] static Reply<Plan> with(Plan plan, Query query, CounterMode counters);
    /// Returns a copy of `plan` for closest hits whose traversal is told to an observer, on the
    /// CPU.
    [[nodiscard]] static Reply<Plan> observed(Plan plan);
    /// The scene as rays see it. After select().
    [[nodiscard]] const SceneView& view() const {
        return selected ? selected->view() : scene.snapshot().view();
    }
    /// Returns the source of columns; the caller adds rays and hits.
    [[nodiscard]] ColumnSource source(const Registry& registry) const;
};

/// Maximum bytes of a chunk's hit records or counters; it bounds the rays of a chunk if a ray has
/// many of them.
inline constexpr std::uint64_t hit_bytes_max = 8ULL << 20;

/// Returns the submission of a job with this plan; the caller adds the job itself.
[[nodiscard]] JobSubmission accept(const Plan& plan, const char* kind, std::uint64_t rays);

/// Returns STARTED with the fields that the plan knows.
[[nodiscard]] wire::StartedT started(const Plan& plan, const protocol::Limits& limits);

}  // namespace raynest::server
