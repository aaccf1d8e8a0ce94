// The description of a job, in flight or kept.
#pragma once

#include "protocol/wire.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/detached.h"

namespace raynest::server {

/// Describes a job in flight.
[[nodiscard]] wire::JobInfoT job_info(const JobRecord& record);
/// Describes a detached job, in flight or ended.
[[nodiscard]] wire::JobInfoT job_info(const DetachedJob& job, const Admission& admission);

}  // namespace raynest::server
