// Receives the rows of an edit, makes the changed scene and publishes it as the next epoch.
//
//   receiving ──► editing (a task) ──► publishing ──► keeping (a task, if asked for) ──► ended
//                    ▲                     │ another edit was faster, and any epoch will do
//                    └─────────────────────┘
//
// Others see an edit before it is kept, so that many are committed together; its client is answered
// after. The old epoch stays whole until its last reader ends, whatever happens here.
#pragma once

#include "server/ground/budget.h"
#include "server/jobs/edit_rows.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"
#include "server/security/caller.h"

#include <cstdint>
#include <memory>
#include <string>

namespace raynest::server {

/// The checked contents of an EDIT request.
struct EditOrder {
    std::string scene;
    std::uint64_t epoch = 0;  ///< 0: the current one, whatever it is
    EditContent content;
    bool keep = false;    ///< end when the scene, as it is then, outlives the daemon
    Budget::Lease lease;  ///< for the content's bytes
};

[[nodiscard]] std::unique_ptr<Job> edit_job(const Services& services, const Caller& caller,
                                            EditOrder order);

}  // namespace raynest::server
