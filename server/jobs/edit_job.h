// Receives the rows of an edit, makes the changed scene and publishes it as the next epoch.
//
//   receiving ──► editing (a task) ──► publishing ──► ended
//                    ▲                     │ another edit was faster, and any epoch will do
//                    └─────────────────────┘
//
// The old epoch stays whole until its last reader ends, whatever happens here.
#pragma once

#include "protocol/edit_row.h"
#include "server/ground/budget.h"
#include "server/jobs/services.h"
#include "server/scheduling/job.h"
#include "server/security/caller.h"
#include "server/store/named_scene.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {

using protocol::EditRow;

/// The checked contents of an EDIT request.
struct EditOrder {
    std::string scene;
    std::uint64_t epoch = 0;  ///< 0: the current one, whatever it is
    std::vector<std::string> targets;
    /// A scene of which placements are added, with its share of --memory.
    struct Source {
        std::shared_ptr<const HeldScene> held;
        std::string name;  ///< in paths
    };
    std::vector<Source> sources;
    std::uint32_t rows = 0;
    std::vector<std::uint32_t> vertex_counts;  ///< of the meshes behind the rows
    [[nodiscard]] std::uint64_t bytes() const;  ///< of the rows and vertices
    Budget::Lease lease;                       ///< for these
};

[[nodiscard]] std::unique_ptr<Job> edit_job(const Services& services, const Caller& caller,
                                            EditOrder order);

}  // namespace raynest::server
