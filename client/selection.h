// --hide and --only: what of a scene rays enter. Instances are outermost ones.
//
//   "inst=3", "object=2", "birch-17/leaves" ──find_selection()──► "inst=17" ──► lists of the Job
#pragma once

#include "client/commands/commands.h"

#include <string>

namespace raynest::client {

/// Checks a text; one of another form is the text of a path.
Result<void> check_selection(const std::string& text);

/// Replaces the texts of paths by the instances that hold them, which the daemon finds.
Result<void> find_selection(Context& context, JobOptions& job);

/// Adds "inst=N" and "object=N" to the lists of a Job.
void add_selection(const JobOptions& options, wire::JobT& job);

}  // namespace raynest::client
