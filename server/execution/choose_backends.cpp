#include "server/execution/choose_backends.h"

#include <optional>
#include <string>

namespace raynest::server {
namespace {

std::optional<Unavailable> unavailable_reason(Backend& backend, const Plan& plan,
                                              std::span<const Plan* const> others) {
    auto why = backend.unavailable_reason(plan);
    for (const Plan* other : others)
        if (!why) why = backend.unavailable_reason(*other);
    return why;
}

Reply<Backend*> find_backend(const Backends& backends, const std::string& name) {
    std::string known = "auto";
    for (auto backend = backends.rbegin(); backend != backends.rend(); ++backend) {
        if ((*backend)->name() == name) return backend->get();
        known += ", " + std::string((*backend)->name());
    }
    return refuse(Code::invalid_field, "unknown worker '" + name + "': use one of " + known);
}

}  // namespace

Reply<void> choose_backends(const Backends& backends, std::uint64_t rays, Plan& plan,
                            std::span<const Plan* const> others) {
    BackendChoice& choice = plan.backends;
    if (choice.asked != "auto") {
        const auto found = find_backend(backends, choice.asked);
        if (!found) return tl::unexpected(found.error());
        if (const auto why = unavailable_reason(**found, plan, others))
            return tl::unexpected(unavailable_error(**found, *why));
        choice.order = {*found};
        return {};
    }
    const std::string cpu(backends.back()->name());
    for (const auto& backend : backends) {
        const std::uint64_t least = backend->job_rays_min();
        auto why = unavailable_reason(*backend, plan, others);
        if (!why && rays < least)
            why = Unavailable{"fewer than " + std::to_string(least) + " rays"};
        const bool decides = choice.order.empty() && choice.reason.empty();
        if (why && decides && !why->absent) choice.reason = cpu + ": " + why->reason;
        if (why) continue;
        if (decides && least != 0)
            choice.reason =
                std::string(backend->name()) + ": at least " + std::to_string(least) + " rays";
        choice.order.push_back(backend.get());
    }
    return {};
}

}  // namespace raynest::server
