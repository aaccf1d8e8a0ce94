// A query that is answered with columns: a row per ray, or per hit.
//
// The number of hits of kind `all` is known only after tracing. A task promises a frame of bounded
// size, answers as many of its rays as fit, and returns the others to the queue. The next task gets
// as many rays as fitted.
#pragma once

#include "server/documents/columns.h"
#include "server/jobs/query_job.h"

#include <memory>

namespace raynest::server {

/// Makes the job. Fails if the answer of one ray does not fit a frame that the client can receive.
Reply<std::unique_ptr<QueryJob>> columns_job(const Services& services, const Caller& caller,
                                             Plan plan, RaySource source, Columns columns);

}  // namespace raynest::server
