// A sensor in motion whose trajectory the client sends, in UPLOAD frames: a lidar that turns, or a
// camera that reads its picture row by row.
#pragma once

#include "engine/integrators/generators.h"
#include "protocol/frame.h"
#include "protocol/limits.h"
#include "server/ground/budget.h"
#include "server/ground/errors.h"
#include "server/ground/stop.h"
#include "server/jobs/received_file.h"

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace raynest::server {

/// A sweep as its request describes it; the counts are within their limits. A line is what is
/// measured at one time: a column of a scan, or a row of the camera's picture.
struct SweepOrder {
    std::uint32_t poses = 0;
    std::optional<Pinhole> camera;  ///< nothing: a lidar, with all that follows; its pose is unused
    std::vector<LidarChannel> channels;
    bool sends_elevations = false;  ///< those of the channels follow the poses
    std::uint32_t columns = 0;      ///< columns in a scan
    std::uint32_t scans = 1;
    double begin = 0, end = 0;  ///< the first scan's
    SensorPose limits;          ///< the range of its rays
    /// The azimuths divide it, its end left out; nothing: they follow the elevations.
    std::optional<std::pair<double, double>> turn;
    /// How far what moves in the scene may be from where it is; nothing: the scene stands still.
    std::optional<double> step_error;

    [[nodiscard]] std::uint64_t sent_bytes() const;
    /// Those of a scan, or of the picture.
    [[nodiscard]] std::uint32_t lines() const { return camera ? camera->size.height : columns; }
    [[nodiscard]] std::uint64_t all_lines() const { return std::uint64_t{scans} * lines(); }
    /// When a line is measured, counted through all scans.
    [[nodiscard]] double time_of(std::uint64_t line) const {
        return begin + (end - begin) * static_cast<double>(line) / lines();
    }
    /// The line of a ray, by its number in the sensor.
    [[nodiscard]] std::uint64_t line_of(std::uint64_t ray) const {
        const std::uint64_t row = ray / grid().width;
        return camera ? row : row / channels.size() * columns + ray % columns;
    }
    [[nodiscard]] ImageSize grid() const {
        return camera ? camera->size
                      : ImageSize{columns, static_cast<std::uint32_t>(channels.size()) * scans};
    }
    /// Bytes of memory while it runs.
    [[nodiscard]] std::uint64_t held_bytes() const {
        constexpr std::uint64_t steps_most = 64ULL << 10;  // for a scene that moves
        constexpr std::uint64_t step_bytes = 128;          // in all tables of steps and scans
        const std::uint64_t steps =
            step_error ? scans + std::min<std::uint64_t>(all_lines(), steps_most) : 0;
        return sent_bytes() + all_lines() * (sizeof(Pose) + sizeof(Vec3)) + steps * step_bytes;
    }
};

/// Fails for a channel that looks further up than straight up, or down.
Reply<void> check_elevations(std::span<const LidarChannel> channels);

/// Receives the trajectory and makes the sensor. Functions are called on the io thread; the tasks
/// that next() returns run elsewhere, one at a time.
class SentSweep {
public:
    explicit SentSweep(SweepOrder order) : order_(std::move(order)) {}

    [[nodiscard]] const SweepOrder& order() const { return order_; }
    /// Makes room for what is sent. `lease` is for order().held_bytes().
    void begin(Budget::Lease lease);
    /// Takes an UPLOAD frame. Returns the bytes that were freed at once.
    Reply<std::uint64_t> feed(protocol::Frame frame, const protocol::Limits& limits);
    [[nodiscard]] bool needs_input() const { return !file_ || !file_->complete(); }
    [[nodiscard]] std::uint64_t take_freed() { return copies_.take_freed(); }
    [[nodiscard]] std::uint64_t held_bytes() const { return lease_.bytes(); }
    /// True once the sensor can be used.
    [[nodiscard]] bool is_made() const { return made_ == Made::done; }
    /// Returns the next task on the way there; nothing while one runs, or while more must come.
    std::optional<Task> next();
    /// Called when a task has ended.
    void ended();
    /// The sensor, once. After is_made().
    [[nodiscard]] Sensor take_sensor() { return std::move(*sensor_); }
    /// Velocity of the sensor at a ray, by its number, in the trajectory's units. After is_made().
    [[nodiscard]] Vec3 velocity_at(std::uint64_t ray) const {
        return velocities_[order_.line_of(ray)];
    }

private:
    Reply<void> make(const Stop& stop);

    const SweepOrder order_;
    Budget::Lease lease_;
    std::optional<ReceivedFile> file_;
    UploadCopies copies_;
    enum class Made { no, runs, done } made_ = Made::no;
    std::optional<Sensor> sensor_;  ///< written by the task
    std::vector<Vec3> velocities_;  ///< each line's; by the task, too
};

}  // namespace raynest::server
