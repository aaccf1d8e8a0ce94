// Receives the rows of an edit, makes the changed scene and publishes it as the next epoch.
//
//   receiving ──► editing (a task) ──► publishing ──► ended
//                    ▲                     │ another edit was faster, and any epoch will do
//                    └─────────────────────┘
//
// The old epoch stays whole until its last reader ends, whatever happens here.
#pragma once

#include "server/ground/budget.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"
#include "server/security/caller.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {

/// A row as it travels. `m` is a 3x4 matrix, row by row.
struct EditRow {
    /// place: from the object's space to the world. move: on top of where it stands, in the world.
    enum What : std::uint32_t { place, move, set_mask, what_count };
    std::uint32_t what;
    std::uint32_t target;   ///< an outermost instance, or an index in EditOrder::targets
    std::uint32_t by_text;  ///< 1: in EditOrder::targets
    std::uint32_t mask;     ///< of set_mask
    double m[12];           ///< of the others
};
static_assert(sizeof(EditRow) == 112);

/// The checked contents of an EDIT request.
struct EditOrder {
    std::string scene;
    std::uint64_t epoch = 0;  ///< 0: the current one, whatever it is
    std::vector<std::string> targets;
    std::uint32_t rows = 0;
    Budget::Lease lease;  ///< for the rows
};

[[nodiscard]] std::unique_ptr<Job> edit_job(const Services& services, const Caller& caller,
                                            EditOrder order);

}  // namespace raynest::server
