// A job of the daemon as JSON and as a row of a table.
#pragma once

#include "client/ground/json.h"
#include "client/requests/listings.h"

#include <string>
#include <vector>

namespace raynest::client {

[[nodiscard]] Json job_json(const wire::JobInfo& info);
/// Returns the columns of a table of jobs, and a job's row.
[[nodiscard]] std::vector<std::string> job_header();
[[nodiscard]] std::vector<std::string> job_row(const wire::JobInfo& info);

}  // namespace raynest::client
