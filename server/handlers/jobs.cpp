// JOBS: lists the caller's jobs in flight and kept answers, an administrator's all of them, a page at
// a time.
#include "server/handlers/handler.h"
#include "server/handlers/job_info.h"

#include <map>
#include <memory>
#include <utility>

namespace raynest::server {
namespace {

/// Jobs per page: below the limit of 256 tables per message, and the longest texts still fit.
constexpr std::size_t page_jobs = 32;

}  // namespace

Reply<Answer> jobs(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Jobs>& message) {
    std::map<std::uint64_t, wire::JobInfoT> found;
    // Another's job tells of scenes that the caller may not see.
    const auto shows = [&](const JobRecord& record) {
        return record.principal == caller.principal || caller.role == Role::admin;
    };
    for (const auto& [number, record] : services.admission.jobs())
        if (number > message->after() && shows(record)) found[number] = job_info(record);
    for (const auto& [number, job] : services.detached.all())
        if (number > message->after() && shows(job->record()))
            found[number] = job_info(*job, services);

    wire::JobListT list;
    for (auto& [number, info] : found) {
        list.more = list.jobs.size() == page_jobs;
        if (list.more) break;
        list.jobs.push_back(std::make_unique<wire::JobInfoT>(std::move(info)));
    }
    return answer_with(caller, list, services);
}

}  // namespace raynest::server
