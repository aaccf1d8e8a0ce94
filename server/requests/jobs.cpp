// JOBS: lists the caller's jobs in flight and kept answers, an administrator's all of them, a page
// at a time.
#include "server/documents/job_info.h"
#include "server/requests/request.h"

#include <memory>

namespace raynest::server {
namespace {

/// Jobs per page: below the limit of 256 tables per message, and the longest texts still fit.
constexpr std::size_t page_jobs = 32;

}  // namespace

Reply<Answer> jobs(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Jobs>& message) {
    // Another's job tells of scenes that the caller may not see.
    const auto shows = [&](const JobRecord& record) {
        return record.principal == caller.principal || caller.role == Role::admin;
    };
    // Walk both tables by number: a detached job that runs is in both.
    const auto& kept_jobs = services.detached.all();
    const auto& running_jobs = services.admission.jobs();
    auto kept = kept_jobs.upper_bound(message->after());
    auto running = running_jobs.upper_bound(message->after());
    wire::JobListT list;
    while (!list.more && (kept != kept_jobs.end() || running != running_jobs.end())) {
        const bool is_kept = running == running_jobs.end() ||
                             (kept != kept_jobs.end() && kept->first <= running->first);
        const JobRecord& record = is_kept ? kept->second->record() : running->second;
        if (shows(record)) {
            list.more = list.jobs.size() == page_jobs;
            if (!list.more)
                list.jobs.push_back(std::make_unique<wire::JobInfoT>(
                    is_kept ? job_info(*kept->second, services.admission) : job_info(record)));
        }
        const std::uint64_t number = is_kept ? kept->first : running->first;
        if (kept != kept_jobs.end() && kept->first == number) ++kept;
        if (running != running_jobs.end() && running->first == number) ++running;
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server
