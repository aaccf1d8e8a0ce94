// CANCEL_JOB: ends one of the caller's jobs, on any connection, and drops its kept answer.
#include "server/documents/job_info.h"
#include "server/requests/request.h"

namespace raynest::server {

Reply<Answer> cancel_job(const Services& services, const Caller& caller,
                         const protocol::Opened<wire::CancelJob>& message) {
    const std::uint64_t number = message->job();
    wire::JobInfoT info;
    if (const JobRecord* attached = services.admission.find(number);
        attached != nullptr && !attached->detached) {
        info = job_info(*attached);
        // Copy the function: calling it destroys the job's record, which owns it.
        const std::function<void()> cancel = attached->cancel;
        cancel();
    } else {
        const auto job = services.detached.find(number);
        if (!job) return tl::unexpected(job.error());
        info = job_info(**job, services.admission);
        services.detached.cancel(number);
    }
    info.state = "cancelled";
    return answer_with(caller, info, services);
}

}  // namespace raynest::server
