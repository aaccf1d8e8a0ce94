#include "server/jobs/admission.h"

#include <algorithm>

namespace raynest::server {

Reply<Admission::Slot> Admission::enter(const std::string& principal, std::uint64_t rays) {
    const auto known = uses_.find(principal);
    const Use use = known == uses_.end() ? Use{} : known->second;
    if (use.jobs >= limits_.principal_jobs_max)
        return refuse(Code::quota, principal + " has " + std::to_string(use.jobs) +
                                       " requests in flight, the limit is principal_jobs_max = " +
                                       std::to_string(limits_.principal_jobs_max));
    if (rays > limits_.principal_rays_max || use.rays > limits_.principal_rays_max - rays)
        return refuse(Code::quota, principal + " has " + std::to_string(use.rays) +
                                       " rays in flight and asks for " + std::to_string(rays) +
                                       " more, the limit is principal_rays_max = " +
                                       std::to_string(limits_.principal_rays_max));
    if (active_ >= jobs_max_)
        return tl::unexpected(protocol::Error{Code::busy, "", retry_after_ms()});

    const auto entered = uses_.try_emplace(principal).first;
    ++entered->second.jobs;
    entered->second.rays += rays;
    ++active_;
    return Slot(this, entered, rays);
}

void Admission::leave(Uses::iterator use, std::uint64_t rays) {
    --active_;
    use->second.rays -= rays;
    if (--use->second.jobs == 0) uses_.erase(use);
}

std::uint32_t Admission::retry_after_ms() const {
    const double ms = 1e3 * mean_ / static_cast<double>(jobs_max_);
    return static_cast<std::uint32_t>(std::clamp(ms, 10.0, 10'000.0));
}

}  // namespace raynest::server
