// The description of a job, in flight or kept.
#pragma once

#include "server/requests/request.h"

namespace raynest::server {

/// Describes a job in flight.
[[nodiscard]] wire::JobInfoT job_info(const JobRecord& record);
/// Describes a detached job, in flight or ended.
[[nodiscard]] wire::JobInfoT job_info(const DetachedJob& job, const Services& services);

}  // namespace raynest::server
