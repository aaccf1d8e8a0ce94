// Reducers, queries whose answer is a sum over rays: hit_fraction per point, visible_pixels per
// instance path. Sums are integers, so they do not depend on chunks and threads.
#pragma once

#include "server/jobs/query_job.h"

#include <memory>
#include <string_view>

namespace raynest::server {

/// Returns the kind of a query that names none: the cheapest that its reducer can use.
[[nodiscard]] std::string_view default_kind(std::string_view reduce);

/// Fails with INVALID_FIELD if the reducer is unknown, or the query names columns beside it.
[[nodiscard]] Reply<void> check_reduce(const wire::Query& query);

/// Makes the job of a query with a reducer. Fails with INVALID_FIELD if it cannot
/// reduce these rays.
Reply<std::unique_ptr<QueryJob>> reduce_job(const Services& services, const Caller& caller,
                                            Plan plan, RaySource source,
                                            const protocol::Opened<wire::Query>& message);

}  // namespace raynest::server
