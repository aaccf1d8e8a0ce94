// The line that the log has for each job that ended.
#pragma once

#include "server/jobs/admission.h"

#include <optional>

namespace raynest::server {

/// One line, `job number=... principal=... kind=...`: at `info` where the job is detached, took
/// over a second, was cancelled, or is a load that failed; at `debug` otherwise.
void log_job(const JobRecord& record, Clock::time_point ended,
             const std::optional<protocol::Error>& error);

}  // namespace raynest::server
