// Queries whose answer is a sum over rays: hit_fraction per point, visible_pixels per instance
// path. Sums are of whole numbers, so they do not depend on chunks and threads.
#pragma once

#include "server/handlers/query_job.h"

#include <memory>
#include <string_view>

namespace raynest::server {

/// The kind of a query that names none: what its reducer needs, and no more.
[[nodiscard]] std::string_view default_kind(std::string_view reduce);

/// INVALID_FIELD for an unknown reducer, or one that cannot reduce these rays.
Reply<std::unique_ptr<QueryJob>> reduce_job(const Services& services, const Caller& caller,
                                            Plan plan, RaySource source,
                                            const protocol::Opened<wire::Query>& message);

}  // namespace raynest::server
