// Logs a line for each job that ended.
#pragma once

#include "server/scheduling/admission.h"

#include <optional>

namespace raynest::server {

/// Logs `job number=... principal=... kind=...`. The level is `info` if the job is detached, took
/// over a second, was cancelled by its client or the daemon, or is a load that failed; `error` if a
/// defect ended it; else `debug`.
void log_job(const JobRecord& record, Clock::time_point ended,
             const std::optional<protocol::Error>& error);

}  // namespace raynest::server
