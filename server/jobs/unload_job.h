// Unloads scenes, and removes those from the state folder before it answers.
#pragma once

#include "protocol/control.h"
#include "server/ground/errors.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"

#include <functional>
#include <memory>

namespace raynest::server {

/// `unload` drops the names in memory, on the io thread, once the job runs.
[[nodiscard]] std::unique_ptr<Job> unload_job(const Services& services, std::uint64_t request_id,
                                              std::function<Reply<wire::UnloadedT>()> unload);

}  // namespace raynest::server
