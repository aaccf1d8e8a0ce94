// Loads a scene at the start of the daemon, without a client.
#pragma once

#include "server/requests/request.h"

#include <string>

namespace raynest::server {

/// Makes the job that loads a source of --load under the name that a client would give it, shared
/// with everybody: a file of this machine, builtin:NAME or root:PATH. Fails as LOAD does. Io thread
/// only.
[[nodiscard]] Reply<JobSubmission> load_at_start(const Services& services, const Caller& caller,
                                                 const std::string& source);

}  // namespace raynest::server
