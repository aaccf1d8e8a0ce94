// heatmap --diff: what a heat map is compared with, another scene or other settings.
#pragma once

#include "client/ground/failure.h"
#include "client/requests/request_options.h"

#include <string>

namespace raynest::client {

/// Takes OTHER_SCENE or KEY=VALUE as given with --diff: intersector, mask, epoch, or a parameter of
/// the intersector. Exit code 2 for what makes no difference.
Result<void> read_difference(const std::string& text, Difference& difference);

/// Returns the job that a difference compares `job` with.
[[nodiscard]] JobOptions other_job(const JobOptions& job, const Difference& difference);

}  // namespace raynest::client
