// Gives the device's process a scene: of an edited one only what the edits have changed, where the
// process still has a scene that it was edited from.
#pragma once

#include "engine/scene/snapshot.h"
#include "protocol/limits.h"
#include "server/backends/cuda/process.h"
#include "server/execution/backend.h"
#include "server/ground/budget.h"
#include "server/ground/metrics.h"

#include <tl/expected.hpp>

#include <chrono>
#include <cstdint>

namespace raynest::server::device {

/// Returns the time limit of an upload. It is bounded because deadlines of jobs are not checked
/// during an upload.
std::chrono::milliseconds load_time_max(const protocol::Limits& limits, std::uint64_t scene_bytes);

/// Where uploads take memory and count.
struct UploadContext {
    Budget& budget;
    Metrics& metrics;
    const protocol::Limits& limits;
};

/// Uploads a scene that the process does not have, on a slot that the caller holds. Blocking; one
/// upload at a time per process. Returns the worker's answer. Fails with resource_exhausted if the
/// daemon has no memory to hand the scene over.
tl::expected<Outcome, Unavailable> upload(Process& process, std::uint32_t slot,
                                          const Snapshot& scene, const UploadContext& context);

}  // namespace raynest::server::device
