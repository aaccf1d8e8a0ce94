// The CUDA backend sends chunks of rays to a process that owns the GPU (cuda/supervisor.h).
#include "server/backends/backends.h"
#include "server/backends/cuda/probe.h"
#include "server/backends/cuda/supervisor.h"
#include "server/backends/cuda/worker_process.h"
#include "server/execution/plan.h"
#include "server/ground/log.h"
#include "server/scheduling/fair_thread_pool.h"

#include <algorithm>
#include <filesystem>

namespace raynest::server {
namespace {

/// Maximum concurrent calls, so that copies of one overlap with the kernel of another. A small
/// --memory allows fewer.
constexpr unsigned calls_max = 4;
static_assert(calls_max <= device::slots_max);
/// Threads for calls of other scenes while the calls of one scene wait for its upload.
constexpr unsigned spare_threads = 4;
/// Minimum number of rays of a job that `auto` sends to the GPU.
constexpr std::uint64_t rays_min = 65536;

/// Maximum rays per call: `cuda_rays_max`, but at least the rays of a frame and at most as many as
/// there is room for hits. A large GPU runs more threads at once than a frame has rays. A call
/// cannot be interrupted, so other jobs, cancels and deadlines wait for the calls before them: at
/// 2^17 usual rays some milliseconds each. A lower cuda_rays_max suits a small GPU on which calls
/// exceed cuda_call_ms_max.
std::uint64_t rays_max(const protocol::Limits& limits) {
    return std::clamp(limits.cuda_rays_max, limits.chunk_rays_max,
                      hit_bytes_max / sizeof(HitRecord));
}

device::Kernel kernel_of(const Plan& plan) {
    return {plan.variant->name, plan.query, plan.settings.params.size()};
}

class CudaBackend final : public Backend {
public:
    CudaBackend(device::Supervisor::Options options, const BackendContext& context)
        : limits_(context.limits),
          supervisor_(std::move(options), context.registry, context.budget, context.metrics,
                      context.limits),
          pool_(supervisor_.slots(), FairThreadPool::Time::clock, spare_threads) {}

    [[nodiscard]] std::string_view name() const override { return "cuda"; }
    [[nodiscard]] std::string title() const override { return "the CUDA worker"; }
    [[nodiscard]] std::string target(const Plan& /*plan*/) const override { return "cuda"; }
    [[nodiscard]] std::vector<std::string> kernels() override { return supervisor_.kernels(); }
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Plan& plan) override {
        if (plan.untraced) return Unavailable{"kind null traces nothing"};
        if (plan.selected) return Unavailable{"hidden instances are the CPU's"};
        if (plan.counters != counters_none)
            return Unavailable{"counters are defined by the CPU's traversal"};
        if (plan.traversal != traversal_auto)
            return Unavailable{std::string("traversal ") + traversal_name(plan.traversal) +
                               " is the CPU's"};
        return supervisor_.unavailable_reason(kernel_of(plan), plan.scene.snapshot());
    }
    [[nodiscard]] std::uint64_t job_rays_min() const override { return rays_min; }
    [[nodiscard]] std::uint64_t call_rays_max(const Plan& plan) const override {
        return std::min(plan.hit_rays_max(), rays_max(limits_));
    }
    [[nodiscard]] FairThreadPool* pool() override { return &pool_; }
    [[nodiscard]] bool makes_camera_rays() const override { return true; }
    Traced<Traversal> trace(const Plan& plan, const TraceCall& call, const PinholeRays* camera,
                            const Stop& /*stop*/) override {
        const auto traced = supervisor_.trace(kernel_of(plan), plan.scene.snapshot(), call, camera);
        if (!traced) return tl::unexpected(TraceFailure(traced.error()));
        return traversal_single;  // one ray per thread
    }

private:
    const protocol::Limits& limits_;
    device::Supervisor supervisor_;
    FairThreadPool pool_;  ///< last member: its calls end before the process does
};

/// Stands in for a GPU that this daemon does not use; refuses every plan with the reason.
class NoCuda final : public Backend {
public:
    explicit NoCuda(const std::string& reason)
        : why_{"this daemon has no CUDA worker" + reason, Code::unsupported, 0, false, true} {}
    [[nodiscard]] std::string_view name() const override { return "cuda"; }
    [[nodiscard]] std::string title() const override { return "the CUDA worker"; }
    [[nodiscard]] std::string target(const Plan& /*plan*/) const override { return "cuda"; }
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Plan& /*plan*/) override {
        return why_;
    }
    [[nodiscard]] std::uint64_t call_rays_max(const Plan& /*plan*/) const override { return 1; }
    Traced<Traversal> trace(const Plan& /*plan*/, const TraceCall& /*call*/,
                            const PinholeRays* /*camera*/, const Stop& /*stop*/) override {
        return tl::unexpected(TraceFailure(why_));
    }

private:
    const Unavailable why_;
};

}  // namespace

std::unique_ptr<Backend> make_cuda(const BackendContext& context) {
    const std::string& pack = context.cuda_pack;
    if (pack.empty()) return std::make_unique<NoCuda>("");
    // CPUs of target v2 have no fma: answers would differ between the GPU and the CPU that takes
    // over its chunks.
    const auto variants = context.registry.variants();
    if (std::any_of(variants.begin(), variants.end(),
                    [](const Variant& variant) { return variant.target == "v2"; })) {
        const std::string why =
            "answers of target v2 may differ from those of a GPU; use --target v3 or v4";
        log(LogLevel::warn, "cuda_off", {{"reason", why}});
        return std::make_unique<NoCuda>(": " + why);
    }
    device::Supervisor::Options options;
    options.command = {std::filesystem::read_symlink("/proc/self/exe").string(),
                       std::string(device::worker_flag), pack};
    options.shape = {rays_max(context.limits), hit_bytes_max / sizeof(HitRecord)};
    const std::uint64_t room = device::slots_share(context.budget.limit()) / options.shape.bytes();
    options.slots = static_cast<std::uint32_t>(std::clamp<std::uint64_t>(room, 1, calls_max));
    return std::make_unique<CudaBackend>(std::move(options), context);
}

}  // namespace raynest::server
