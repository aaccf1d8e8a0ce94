// Makes a plan of the words of a wire::Job.
#pragma once

#include "protocol/wire.h"
#include "server/execution/plan.h"
#include "server/jobs/services.h"
#include "server/security/caller.h"

namespace raynest::server {

/// Makes the plan of a job; an error names the wrong word. Counters force the single traversal
/// on the CPU, and a note to the user says so. A lit picture blends where no intersector is named.
Reply<Plan> make_plan(const Services& services, const Caller& caller, const wire::Job& job,
                      Query query, CounterMode counters = counters_none, bool lit = false);

}  // namespace raynest::server
