// What wait, fetch, cancel and jobs share: how a job of the daemon reads.
#pragma once

#include "client/connection.h"
#include "client/output.h"

#include <cstdint>
#include <string>

namespace raynest::client {

[[nodiscard]] Json job_json(const wire::JobInfo& info);
/// "query", or "query closest".
[[nodiscard]] std::string job_kind(const wire::JobInfo& info);
/// "job 17 (query closest, forest)".
[[nodiscard]] std::string job_text(const wire::JobInfo& info);
/// Why a job failed, as its own client would have read it; nothing when it did not.
Result<void> check_job(const wire::JobInfo& info);
/// What is told about the job of this number. Asks for a list that begins with it; JOB_UNKNOWN when
/// it does not.
struct FoundJob {
    Reply<wire::JobList> list;
    const wire::JobInfo* info = nullptr;
};
Result<FoundJob> find_job(Connection& connection, std::uint64_t number);

}  // namespace raynest::client
