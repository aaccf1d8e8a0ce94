// Changes scenes, and has that on the disk before it answers.
#pragma once

#include "protocol/frame.h"
#include "server/ground/errors.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"

#include <functional>
#include <memory>

namespace raynest::server {

/// Writes to the disk, and returns the answer. On a thread for the disk.
using WriteToDisk = std::function<Reply<protocol::Frame>()>;

/// `change` changes what is in memory, on the io thread, once the job runs.
[[nodiscard]] std::unique_ptr<Job> disk_job(const Services& services,
                                            std::function<Reply<WriteToDisk>()> change);

}  // namespace raynest::server
