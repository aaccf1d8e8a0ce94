// Where a sensor in motion is at a time: rigid poses at known times, and between them.
#pragma once

#include "engine/geometry/pinhole.h"
#include "server/ground/errors.h"

#include <span>
#include <vector>

namespace raynest::server {

/// Poses of a sensor at ascending times. Between two of them positions lie on a line and rotations
/// on the shortest arc, in float64.
class Trajectory {
public:
    /// `rows` has 13 numbers for each pose: its time, and the matrix (3, 4) from the sensor's space
    /// to the world, row by row. Fails with INVALID_FIELD unless all are finite, times ascend and
    /// each matrix turns and moves alone.
    static Reply<Trajectory> of(std::span<const double> rows);

    static constexpr std::size_t row_numbers = 13;

    [[nodiscard]] double begin() const { return times_.front(); }
    [[nodiscard]] double end() const { return times_.back(); }
    /// The pose at a time from begin() to end().
    [[nodiscard]] Pose at(double time) const;
    /// Its velocity then; at the time of a pose that of the line which begins there.
    [[nodiscard]] glm::dvec3 velocity_at(double time) const;

private:
    /// The pose at which the line that holds a time ends; there are at least two.
    [[nodiscard]] std::size_t end_of_line(double time) const;

    std::vector<double> times_;
    std::vector<Pose> poses_;
};

}  // namespace raynest::server
