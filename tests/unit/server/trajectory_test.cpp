// Tests the poses and velocities of a sensor between the times at which they are known.
#include "server/execution/trajectory.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <vector>

namespace raynest::server {
namespace {

/// A pose that looks along the axes, at a time and a place; `scale` is the length of its first axis.
void add(std::vector<double>& rows, double time, const glm::dvec3& at, double scale = 1) {
    const std::array<double, Trajectory::row_numbers> row{time, scale, 0, 0, at.x, 0,   1,
                                                          0,    at.y,  0, 0, 1,    at.z};
    rows.insert(rows.end(), row.begin(), row.end());
}

TEST_CASE("a pose may be off by a ten-thousandth, as one that was written in six digits") {
    for (const double off : {0.0, 4e-5, -4e-5, 4e-4, -4e-4}) {
        CAPTURE(off);
        std::vector<double> rows;
        add(rows, 0, {});
        add(rows, 1, {}, 1 + off);  // the square of the length is what is off
        const auto made = Trajectory::of(rows);
        CHECK(made.has_value() == (std::abs(off) < 1e-4));
        if (!made) CHECK(made.error().message.find("pose 1 of the trajectory is not rigid") == 0);
    }
}

TEST_CASE("the velocity at a known time is that of the stretch which begins there") {
    std::vector<double> rows;
    add(rows, 0, {0, 0, 0});
    add(rows, 2, {2, 0, 0});
    add(rows, 3, {2, 0, 4});
    const Trajectory way = Trajectory::of(rows).value();
    CHECK(way.velocity_at(0) == glm::dvec3(1, 0, 0));
    CHECK(way.velocity_at(1.5) == glm::dvec3(1, 0, 0));
    CHECK(way.velocity_at(2) == glm::dvec3(0, 0, 4));
    CHECK(way.velocity_at(3) == glm::dvec3(0, 0, 4));
    CHECK(way.at(2).origin == glm::dvec3(2, 0, 0));
    CHECK(way.at(2.5).origin == glm::dvec3(2, 0, 2));
    rows.resize(Trajectory::row_numbers);
    CHECK(Trajectory::of(rows)->velocity_at(7) == glm::dvec3(0));
}

}  // namespace
}  // namespace raynest::server
