// --hide and --only: what of a scene rays enter. Instances are outermost ones.
//
//   "inst=3", "object=2", "birch-17/leaves" ──find_selection()──► "inst=17" ──► lists of the Job
#pragma once

#include "client/ground/progress.h"
#include "client/net/connection.h"
#include "client/requests/request_options.h"

namespace raynest::client {

/// Replaces the texts of paths by the instances that hold them, which the daemon finds.
Result<void> find_selection(Connection& connection, Progress& progress, JobOptions& job);

}  // namespace raynest::client
