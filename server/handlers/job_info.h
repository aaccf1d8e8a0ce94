// What is told about a job, in flight or kept.
#pragma once

#include "server/handlers/handler.h"

namespace raynest::server {

/// Of one in flight.
[[nodiscard]] wire::JobInfoT job_info(const JobRecord& record);
/// Of a detached one, in flight or not.
[[nodiscard]] wire::JobInfoT job_info(const DetachedJob& job, const Services& services);

}  // namespace raynest::server
