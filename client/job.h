// What render, query and heatmap share: the job part of a request, and what ran.
#pragma once

#include "client/connection.h"
#include "client/options.h"
#include "client/output.h"

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::client {

[[nodiscard]] std::unique_ptr<wire::JobT> job_message(const JobOptions& options);
[[nodiscard]] std::unique_ptr<wire::CameraT> camera_message(const CameraOptions& options,
                                                            const WorldPoint& origin);
/// Of --deadline; 0 when there is none.
[[nodiscard]] std::chrono::milliseconds deadline_of(double seconds);

/// STARTED and DONE in one: filled as their frames come.
struct Outcome {
    std::string scene, hash, intersector, target, traversal, worker, worker_reason;
    std::string camera;  ///< of a picture
    std::uint64_t epoch = 0;
    std::vector<std::string> notes;
    std::uint64_t rays_announced = 0;  ///< of a query, by STARTED
    WorldPoint origin{};               ///< of the scene, by STARTED
    std::vector<std::string> hidden;   ///< columns that users did not ask for, by STARTED
    std::uint64_t rays = 0, hits = 0, misses = 0, truncated = 0;
    std::uint64_t invalid = 0, first_invalid = 0;
    std::optional<std::uint64_t> rows;  ///< of a query, by DONE
    double seconds = 0, queued_seconds = 0;
    wire::HeatStatisticsT heat;  ///< of a heat map
    std::uint64_t detached = 0;  ///< number of the job that goes on without us; 0: it has ended
};
/// Takes what a STARTED, DONE or DETACHED frame says; leaves other frames alone.
Result<void> take_news(const protocol::Frame& frame, Outcome& outcome);

/// The keys that every job's JSON has.
[[nodiscard]] Json outcome_json(const Outcome& outcome);
/// "518,400 rays in 0.412 s (1.26 Mrays/s), alpha_mask on v3, stream, forest epoch 1".
[[nodiscard]] std::string outcome_text(const Outcome& outcome);
/// The daemon's remarks, on stderr.
void print_notes(const Outcome& outcome);

}  // namespace raynest::client
