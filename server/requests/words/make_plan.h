// Makes a plan of the words of a job.
#pragma once

#include "server/execution/plan.h"
#include "server/jobs/services.h"
#include "server/requests/words/job_words.h"
#include "server/security/caller.h"

namespace raynest::server {

/// Says what puts the scene at a moment of its animation: the plan's scene is there, or as it was loaded
/// and edited.
enum class Posing { by_plan, by_job };

/// Makes the plan of a job; an error names the wrong word. Counters force the single traversal
/// on the CPU, and a note to the user says so. A lit picture blends where no intersector is named.
Reply<Plan> make_plan(const Services& services, const Caller& caller, JobWords job, Query query,
                      CounterMode counters = counters_none, bool lit = false,
                      Posing posing = Posing::by_plan);

}  // namespace raynest::server
