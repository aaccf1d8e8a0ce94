// Changes scenes, and has that on the disk before it answers.
#pragma once

#include "protocol/frame.h"
#include "server/ground/errors.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"

#include <functional>
#include <memory>

namespace raynest::server {

struct DiskChange {
    protocol::Frame answer;
    std::function<Reply<void>()> write;  ///< on a thread for the disk
};

/// `change` changes what is in memory, on the io thread, once the job runs.
[[nodiscard]] std::unique_ptr<Job> disk_job(const Services& services,
                                            std::function<Reply<DiskChange>()> change);

}  // namespace raynest::server
