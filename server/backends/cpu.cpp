// The CPU backend runs the kernels of this process on the calling thread.
#include "server/backends/backends.h"
#include "server/execution/plan.h"

#include <algorithm>
#include <chrono>
#include <numeric>
#include <optional>
#include <span>
#include <string>

namespace raynest::server {
namespace {

/// Maximum rays per chunk of the brute-force reference, so that other jobs get its thread soon.
constexpr std::uint64_t reference_rays_max = 64;

/// Stops a chunk when its job is stopped or when it exceeds chunk_ms_max.
class ChunkStop final : public Stop {
public:
    ChunkStop(const Stop& job, std::chrono::milliseconds time)
        : job_(job),
          end_(Clock::now() + time) {}
    [[nodiscard]] bool requested() const noexcept override {
        if (job_.requested()) return true;
        // Kernels ask every 1 to 2 us when rays are short; reading the clock takes 25 ns.
        constexpr unsigned questions_per_look = 4;
        return ++questions_ % questions_per_look == 0 && Clock::now() >= end_;
    }

private:
    const Stop& job_;
    const Clock::time_point end_;
    mutable unsigned questions_ = 0;
};

bool is_requested(const void* chunk) noexcept {
    return static_cast<const ChunkStop*>(chunk)->requested();
}

/// Returns the error of a call that did not end with trace_ok.
protocol::Error error_of(TraceStatus status, const Plan& plan, const Stop& stop,
                         std::chrono::milliseconds time_max) {
    if (status == trace_out_of_memory)
        return {Code::resource_exhausted,
                "the traversal of scene '" + plan.scene.name + "' ran out of memory", 0};
    if (status != trace_cancelled)
        return {Code::internal,
                "intersector '" + plan.variant->name + "' on target " + plan.variant->target +
                    " refused its call",
                0};
    if (stop.requested()) return {Code::cancelled, "", 0};
    return {Code::limit_exceeded,
            "a chunk of rays took longer than --chunk-ms-max " + std::to_string(time_max.count()) +
                ": its rays meet too much of the scene, as they do from very far away or with "
                "directions too short to divide by; look at the rays, or raise the daemon's limit",
            0};
}

/// Tells an observer what steps in the view of a selection are in the scene.
class SceneObserver {
public:
    SceneObserver(const Observer& to, const Selected& selected) : to_(to), selected_(selected) {
        observer_ = {this, &SceneObserver::step, &SceneObserver::end, to.candidates};
    }
    [[nodiscard]] const Observer& observer() const { return observer_; }

private:
    static void step(void* self, const Step* step) noexcept {
        const auto& here = *static_cast<const SceneObserver*>(self);
        const Step in_scene = here.selected_.in_scene(*step);
        here.to_.step(here.to_.context, &in_scene);
    }
    static void end(void* self, std::uint32_t ray, const HitRecord* hit) noexcept {
        const auto& here = *static_cast<const SceneObserver*>(self);
        HitRecord in_scene = *hit;
        here.selected_.name_by_scene({&in_scene, 1});
        here.to_.end(here.to_.context, ray, &in_scene);
    }

    const Observer& to_;
    const Selected& selected_;
    Observer observer_;
};

/// Returns the hit records that a call has written.
std::span<HitRecord> hits_of(const TraceCall& call, Query query) {
    if (query != query_all) return {call.hits, std::uint64_t{call.ray_count} * call.hits_max};
    const std::span<const std::uint32_t> counts(call.hit_counts, *call.rays_done);
    return {call.hits, std::accumulate(counts.begin(), counts.end(), std::uint64_t{0})};
}

class CpuBackend final : public Backend {
public:
    explicit CpuBackend(const protocol::Limits& limits) : limits_(limits) {}

    [[nodiscard]] std::string_view name() const override { return "cpu"; }
    [[nodiscard]] std::string title() const override { return "the CPU"; }
    [[nodiscard]] std::string target(const Plan& plan) const override {
        return plan.variant->target;
    }
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Plan& /*plan*/) override {
        return std::nullopt;
    }
    [[nodiscard]] std::uint64_t call_rays_max(const Plan& plan) const override {
        const std::uint64_t most = std::min(limits_.chunk_rays_max, plan.hit_rays_max());
        return plan.traversal == traversal_reference ? std::min(reference_rays_max, most) : most;
    }
    Traced<Traversal> trace(const Plan& plan, const TraceCall& call, const PinholeRays* /*camera*/,
                            const Stop& stop) override {
        const std::chrono::milliseconds time_max(limits_.chunk_ms_max);
        const ChunkStop chunk(stop, time_max);
        TraceCall bounded = call;
        bounded.cancelled = is_requested;
        bounded.cancelled_context = &chunk;
        std::optional<SceneObserver> watch;
        const bool copies = plan.selected && plan.selected->has_copies();
        if (copies && call.observer != nullptr)
            bounded.observer = &watch.emplace(*call.observer, *plan.selected).observer();
        const Traversal traversal = plan.selector.choose({call.rays, call.ray_count}, *call.scene);
        const TraceStatus status = plan.selector.function(traversal)(&bounded);
        if (status == trace_ok) {
            if (copies) plan.selected->name_by_scene(hits_of(call, plan.query));
            return traversal;
        }
        return tl::unexpected(TraceFailure(error_of(status, plan, stop, time_max)));
    }

private:
    const protocol::Limits& limits_;
};

}  // namespace

std::unique_ptr<Backend> make_cpu(const BackendContext& context) {
    return std::make_unique<CpuBackend>(context.limits);
}

}  // namespace raynest::server
