#include "server/execution/trajectory.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <string>

namespace raynest::server {
namespace {

/// Axes of a pose may be off unit length and right angles by so much.
constexpr double rigid_tolerance = 1e-4;

using Matrix = std::array<glm::dvec3, 3>;  ///< columns

Matrix axes(const Pose& pose) {
    return {pose.x, pose.y, pose.z};
}

bool is_rigid(const Pose& pose) {
    const Matrix m = axes(pose);
    for (std::size_t i = 0; i < 3; ++i)
        for (std::size_t j = 0; j < 3; ++j)
            if (!(std::abs(glm::dot(m[i], m[j]) - (i == j ? 1 : 0)) < rigid_tolerance))
                return false;
    return glm::dot(glm::cross(pose.x, pose.y), pose.z) > 0;
}

Matrix product(const Matrix& a, const Matrix& b) {
    Matrix made;
    for (std::size_t j = 0; j < 3; ++j) made[j] = a[0] * b[j].x + a[1] * b[j].y + a[2] * b[j].z;
    return made;
}

/// The rotation `share` of the way from one to another, along the shortest arc.
Matrix turned(const Matrix& first, const Matrix& second, double share) {
    Matrix turn;
    for (std::size_t j = 0; j < 3; ++j)
        turn[j] = {glm::dot(first[0], second[j]), glm::dot(first[1], second[j]),
                   glm::dot(first[2], second[j])};
    const double cosine = std::clamp((turn[0].x + turn[1].y + turn[2].z - 1) / 2, -1.0, 1.0);
    // The antisymmetric part is the axis times the sine. Near half a turn that is rounding, and the
    // symmetric part, less the cosine, is the axis times itself.
    glm::dvec3 axis =
        glm::dvec3(turn[1].z - turn[2].y, turn[2].x - turn[0].z, turn[0].y - turn[1].x) / 2.0;
    const double sine = glm::length(axis);
    const double angle = std::atan2(sine, cosine) * share;
    if (cosine >= 0) {
        axis /= std::max(sine, 1e-300);
    } else {
        const std::size_t longest = turn[0].x >= turn[1].y ? (turn[0].x >= turn[2].z ? 0 : 2)
                                                           : (turn[1].y >= turn[2].z ? 1 : 2);
        const auto l = static_cast<int>(longest);
        glm::dvec3 along = turn[longest];
        for (int j = 0; j < 3; ++j)
            along[j] = (along[j] + turn[static_cast<std::size_t>(j)][l]) / 2;
        along[l] -= cosine;
        axis = (glm::dot(axis, along) < 0 ? -1.0 : 1.0) / glm::length(along) * along;
    }
    const Matrix across{glm::dvec3{0, axis.z, -axis.y}, glm::dvec3{-axis.z, 0, axis.x},
                        glm::dvec3{axis.y, -axis.x, 0}};
    const Matrix twice = product(across, across);
    Matrix step;
    for (std::size_t j = 0; j < 3; ++j) {
        step[j] = std::sin(angle) * across[j] + (1 - std::cos(angle)) * twice[j];
        step[j][static_cast<int>(j)] += 1;
    }
    return product(first, step);
}

}  // namespace

Reply<Trajectory> Trajectory::of(std::span<const double> rows) {
    Trajectory made;
    const std::size_t count = rows.size() / row_numbers;
    made.times_.reserve(count);
    made.poses_.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
        const auto row = rows.subspan(i * row_numbers, row_numbers);
        const std::string name = "pose " + std::to_string(i) + " of the trajectory";
        if (!std::ranges::all_of(row, [](double value) { return std::isfinite(value); }))
            return refuse(Code::invalid_field, name + " or its time is not finite");
        if (i != 0 && !(row[0] > made.times_.back()))
            return refuse(Code::invalid_field,
                          name + " is not later than the one before: its times must ascend");
        const auto column = [&](std::size_t at) {
            return glm::dvec3(row[1 + at], row[5 + at], row[9 + at]);
        };
        const Pose pose{column(0), column(1), column(2), column(3)};
        if (!is_rigid(pose))
            return refuse(Code::invalid_field,
                          name +
                              " is not rigid: it must turn and move alone, without scale or "
                              "reflection");
        made.times_.push_back(row[0]);
        made.poses_.push_back(pose);
    }
    if (count == 0) return refuse(Code::invalid_field, "the trajectory has no poses");
    return made;
}

std::size_t Trajectory::end_of_line(double time) const {
    const auto behind = std::upper_bound(times_.begin(), times_.end(), time) - times_.begin();
    return static_cast<std::size_t>(
        std::clamp<std::ptrdiff_t>(behind, 1, static_cast<std::ptrdiff_t>(times_.size()) - 1));
}

glm::dvec3 Trajectory::velocity_at(double time) const {
    if (times_.size() == 1) return glm::dvec3(0);
    const std::size_t last = end_of_line(time);
    return (poses_[last].origin - poses_[last - 1].origin) / (times_[last] - times_[last - 1]);
}

Pose Trajectory::at(double time) const {
    if (times_.size() == 1) return poses_.front();
    const std::size_t last = end_of_line(time);
    const Pose& a = poses_[last - 1];
    const Pose& b = poses_[last];
    const double share = (time - times_[last - 1]) / (times_[last] - times_[last - 1]);
    const Matrix way = turned(axes(a), axes(b), share);
    return {way[0], way[1], way[2], (1 - share) * a.origin + share * b.origin};
}

}  // namespace raynest::server
