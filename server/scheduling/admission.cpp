#include "server/scheduling/admission.h"

#include "server/ground/fair_share.h"

namespace raynest::server {

Reply<Admission::Slot> Admission::enter(JobRecord&& record) {
    const std::string& principal = record.principal;
    const auto known = uses_.find(principal);
    const Use use = known == uses_.end() ? Use{} : known->second;
    const Quota quota = quotas_.of(principal);
    if (use.jobs >= quota.jobs)
        return refuse(Code::quota,
                      principal + " has " + std::to_string(use.jobs) + " requests in flight, " +
                          quotas_.limit_text(principal, &Quota::jobs) + "; wait for one of them");
    if (record.rays > quota.rays)
        return refuse(Code::limit_exceeded,
                      "a request of " + std::to_string(record.rays) + " rays, " +
                          quotas_.limit_text(principal, &Quota::rays) + "; ask for less, or " +
                          quotas_.remedy(principal, &Quota::rays));
    if (use.rays > quota.rays - record.rays)
        return refuse(Code::quota, principal + " has " + std::to_string(use.rays) +
                                       " rays in flight and asks for " +
                                       std::to_string(record.rays) + " more, " +
                                       quotas_.limit_text(principal, &Quota::rays) +
                                       "; wait for your other requests");
    if (!fair_place(use.jobs, free_places()))
        return tl::unexpected(protocol::Error{
            Code::busy,
            free_places() == 0
                ? "the daemon works on " + std::to_string(active()) +
                      " requests, as many as its --total-jobs-max allows"
                : principal + " has " + std::to_string(use.jobs) +
                      " requests in flight, its share of --total-jobs-max " +
                      std::to_string(limits_.total_jobs_max) + " now; wait for one of them",
            retry_after_ms()});

    // Both tables change, or none: the step that memory may fail comes before the counts.
    const auto entered = uses_.try_emplace(principal).first;
    try {
        jobs_.try_emplace(last_number_ + 1);
    } catch (...) {
        if (entered->second.jobs == 0) uses_.erase(entered);
        throw;
    }
    ++entered->second.jobs;
    entered->second.rays += record.rays;
    record.number = ++last_number_;
    jobs_.at(last_number_) = std::move(record);
    return Slot(this, last_number_);
}

std::optional<Peers::Whose> Admission::blocking_limit(const std::string& principal) const {
    const auto known = uses_.find(principal);
    if (known != uses_.end() && known->second.jobs >= quotas_.of(principal).jobs)
        return Peers::Whose::own;
    if (free_places() == 0) return Peers::Whose::everybodys;
    if (!fair_place(active_of(principal), free_places())) return Peers::Whose::own;
    return std::nullopt;
}

const JobRecord* Admission::find(std::uint64_t number) const {
    const auto found = jobs_.find(number);
    return found == jobs_.end() ? nullptr : &found->second;
}

void Admission::forget_job(std::uint64_t number) noexcept {
    if (const auto job = jobs_.find(number); job != jobs_.end()) job->second.job = nullptr;
}

void Admission::leave(std::uint64_t number) {
    const auto job = jobs_.find(number);
    const auto use = uses_.find(job->second.principal);
    use->second.rays -= job->second.rays;
    if (--use->second.jobs == 0) uses_.erase(use);
    jobs_.erase(job);
}

std::uint32_t Admission::retry_after_ms() const {
    const double ms = 1e3 * mean_ / static_cast<double>(limits_.total_jobs_max);
    return static_cast<std::uint32_t>(std::clamp(ms, 10.0, 10'000.0));
}

}  // namespace raynest::server
