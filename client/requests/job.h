// Shared by render, query and heatmap: the job part of a request, and its outcome.
#pragma once

#include "client/net/connection.h"
#include "client/requests/request_options.h"

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::client {

[[nodiscard]] std::unique_ptr<wire::JobT> job_message(const JobOptions& options);
/// Asks for the scene at a moment: in a Job, an Info or a Structure.
template <class Message>
void put_moment(const MomentOptions& moment, Message& message) {
    message.timed = moment.time.has_value();
    message.time = moment.time.value_or(0);
    message.animation = moment.animation;
}
[[nodiscard]] std::unique_ptr<wire::CameraT> camera_message(const CameraOptions& options,
                                                            const WorldPoint& origin);
/// Converts --deadline; 0 means no deadline.
[[nodiscard]] std::chrono::milliseconds deadline_of(double seconds);

/// The contents of STARTED and DONE, filled as the frames come.
struct Outcome {
    std::string scene, hash, intersector, target, traversal, worker, worker_reason;
    std::string camera;  ///< pictures only
    std::uint64_t epoch = 0;
    bool has_started = false;  ///< STARTED has come
    bool may_detach = false;   ///< the request asked for a detached job; set by who sends it
    std::vector<std::string> notes;
    std::string note_of_all;           ///< parts of pictures only: a note if all parts have it
    std::uint64_t rays_announced = 0;  ///< queries only, from STARTED
    WorldPoint origin{};               ///< the scene's, from STARTED
    std::vector<std::string> hidden;   ///< columns that users did not ask for, from STARTED
    std::uint64_t rays = 0, hits = 0, misses = 0, truncated = 0;
    std::uint64_t invalid = 0, first_invalid = 0;
    std::uint64_t samples = 0;          ///< per pixel of a lit picture
    float noise = 0;                    ///< estimated error of that picture; 0: not known
    std::uint64_t dropped = 0;          ///< samples that were not finite
    bool incomplete = false;            ///< a lit picture has fewer samples than it was asked for
    std::optional<std::uint64_t> rows;  ///< queries only, from DONE
    double seconds = 0, queued_seconds = 0;
    wire::HeatStatisticsT heat;  ///< heat maps only
    std::uint64_t detached = 0;  ///< number of a detached job; 0: the job has ended
};
/// Reads a STARTED, DONE or DETACHED frame; ignores others. Fails where a job starts twice, or is
/// detached without having been asked to.
Result<void> take_news(const protocol::Frame& frame, Outcome& outcome);

}  // namespace raynest::client
