#include "server/handlers/worker_choice.h"

#include "server/handlers/plan.h"

#include <optional>

namespace raynest::server {
namespace {

/// Nothing where the plan runs on a GPU.
std::optional<device::Refusal> why_not(const Services& services, const Plan& plan) {
    if (services.cuda == nullptr) return device::Refusal{services.why_no_cuda};
    if (plan.untraced) return device::Refusal{"kind null traces nothing"};
    if (plan.counting) return device::Refusal{"counters are defined by the CPU's traversal"};
    if (plan.traversal != traversal_auto)
        return device::Refusal{std::string("traversal ") + traversal_name(plan.traversal) +
                               " is the CPU's"};
    return services.cuda->why_not({plan.variant->name, plan.precision, plan.query},
                                  plan.scene.snapshot());
}

}  // namespace

Reply<void> choose_worker(const Services& services, std::uint64_t rays, Plan& plan) {
    const std::string& word = plan.worker.asked;
    const bool demanded = plan.worker.demanded();
    if (word == "cpu") return {};
    if (word != "auto" && word != "cuda")
        return refuse(Code::invalid_field,
                      "unknown worker '" + word + "': use one of auto, cpu, cuda");
    auto refusal = why_not(services, plan);
    if (refusal && demanded) return tl::unexpected(cuda_refused(*refusal));
    if (services.cuda == nullptr) return {};
    if (!refusal && !demanded && rays < cuda_rays_min)
        refusal = device::Refusal{"fewer than " + std::to_string(cuda_rays_min) + " rays"};
    if (refusal) {
        plan.worker.reason = "cpu: " + refusal->reason;
        return {};
    }
    plan.worker.cuda = services.cuda;
    if (!demanded) plan.worker.reason = "cuda: at least " + std::to_string(cuda_rays_min) + " rays";
    return {};
}

protocol::Error cuda_refused(const device::Refusal& refusal) {
    return {refusal.code, "the CUDA worker: " + refusal.reason + "; use `worker` auto or cpu",
            refusal.retry_after_ms};
}

}  // namespace raynest::server
