// Shared by wait, fetch, cancel and jobs: texts about a job of the daemon.
#pragma once

#include "client/connection.h"
#include "client/output.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace raynest::client {

[[nodiscard]] Json job_json(const wire::JobInfo& info);
/// Returns "query", or "query closest".
[[nodiscard]] std::string job_kind(const wire::JobInfo& info);
/// Returns "job 17 (query closest, forest)".
[[nodiscard]] std::string job_text(const wire::JobInfo& info);
/// Returns the columns of a table of jobs, and a job's row.
[[nodiscard]] std::vector<std::string> job_header();
[[nodiscard]] std::vector<std::string> job_row(const wire::JobInfo& info);
/// Passes on every job that the daemon lists, by number.
Result<void> each_job(Connection& connection,
                      const std::function<void(const wire::JobInfo&)>& consume);
/// Fails with the error of a failed job, as its own client would have read it.
Result<void> check_job(const wire::JobInfo& info);
/// The daemon's entry for a job. find_job() asks for a list that begins with the job's number, and
/// fails with JOB_UNKNOWN if the list begins with another.
struct FoundJob {
    Reply<wire::JobList> list;
    const wire::JobInfo* info = nullptr;
};
Result<FoundJob> find_job(Connection& connection, std::uint64_t number);

}  // namespace raynest::client
