// A pinhole camera as a few numbers, from which a CPU and a GPU make the same rays. All is computed
// in double and rounded once, in the ray.
#pragma once

#include "engine/geometry/ray.h"
#include "engine/geometry/tile_order.h"

#include <cstdint>
#include <limits>

namespace raynest {

/// A sensor's axes and place in the world, in double for the sums below.
struct Pose {
    glm::dvec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1}, origin{0};

    /// A vector of the sensor's frame, rounded.
    [[nodiscard]] RAYNEST_FN Vec3 direction(const glm::dvec3& v) const {
        return Vec3(v.x * x + v.y * y + v.z * z);
    }
    [[nodiscard]] RAYNEST_FN Vec3 point(const glm::dvec3& v) const {
        return Vec3(v.x * x + v.y * y + v.z * z + origin);
    }
};

/// Where a sensor stands, and how far it sees.
struct SensorPose {
    Pose pose;
    float tmin = 0;
    float tmax = std::numeric_limits<float>::infinity();

    /// From the sensor's origin; the direction is in its frame.
    [[nodiscard]] RAYNEST_FN Ray ray(const glm::dvec3& direction) const {
        return {Vec3(pose.origin), tmin, pose.direction(direction), tmax};
    }
};

struct ImageSize {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    [[nodiscard]] RAYNEST_FN std::uint64_t pixels() const { return std::uint64_t{width} * height; }
};

/// The room of a ray between its neighbours: its width at the start, and by how much that grows per
/// unit of t.
struct RayCone {
    float width = 0, spread = 0;
};

/// Through pixel centres, from one point; directions have unit length along the view axis, so that
/// t is the depth.
struct Pinhole {
    SensorPose sensor_pose;
    ImageSize size;
    double center_x = 0, center_y = 0;  ///< principal point, in pixels from the upper left corner
    double step_x = 0, step_y = 0;      ///< change of the direction per pixel: 1 / focal length

    [[nodiscard]] RAYNEST_FN Ray ray(std::uint64_t column, std::uint64_t row) const {
        return ray_at(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5);
    }
    /// Through a point of the image, in pixels from its upper left corner.
    [[nodiscard]] RAYNEST_FN Ray ray_at(double x, double y) const {
        return sensor_pose.ray({(x - center_x) * step_x, (center_y - y) * step_y, -1});
    }
    [[nodiscard]] RayCone cone() const { return {0, static_cast<float>(step_y)}; }
};

/// Rays that lie next to each other in a pinhole's picture: row by row, or in tile order.
struct PinholeRays {
    Pinhole camera;
    std::uint64_t first = 0;
    bool tiles = false;

    /// The i-th, at the same bits as generate_rays() and generate_tiles() give.
    [[nodiscard]] RAYNEST_FN Ray ray(std::uint64_t i) const {
        const std::uint64_t width = camera.size.width;
        const std::uint64_t place = first + i;
        const std::uint64_t pixel = tiles ? tile_order(place, width, camera.size.height) : place;
        return camera.ray(pixel % width, pixel / width);
    }
};

}  // namespace raynest
