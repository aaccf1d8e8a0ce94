// Reducers, queries whose answer is a sum over rays: hit_fraction per point, visible_pixels per
// instance path. Sums are integers, so they do not depend on chunks and threads.
#pragma once

#include "server/jobs/query_job.h"
#include "server/security/caller.h"

#include <memory>
#include <string_view>

namespace raynest::server {

/// Makes the job of a query with a reducer. Fails with INVALID_FIELD if it cannot
/// reduce these rays.
Reply<std::unique_ptr<QueryJob>> reduce_job(const Services& services, const Caller& caller,
                                            Plan plan, RaySource source, std::string_view reduce);

}  // namespace raynest::server
