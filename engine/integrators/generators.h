// Ray generators: sensors whose rays follow from a few numbers, so that none need to be stored or
// sent (PROTOCOL.md, "Generators").
//
// Sensors look along -Z of their pose, +X to the right, +Y up, as cameras do; a
// lidar's axes are those of robotics: x ahead, y left, z up. Poses are applied as they are: the
// caller checks that they do not scale. All is computed in double and rounded once, in the ray.
#pragma once

#include "engine/geometry/pinhole.h"
#include "engine/integrators/camera.h"

#include <cstdint>
#include <numbers>
#include <span>
#include <utility>
#include <variant>
#include <vector>

namespace raynest {

[[nodiscard]] Pose pose_of(const Transform& to_world);
/// The rays of a picture that this perspective camera takes.
[[nodiscard]] Pinhole pinhole(const Camera& camera, ImageSize size);

/// Parallel rays, one per cell of a window that lies around the sensor.
struct Orthographic {
    SensorPose sensor_pose;
    ImageSize size;
    double width = 0, height = 0;  ///< the window's size

    [[nodiscard]] const Pose& pose(std::uint64_t, std::uint64_t) const { return sensor_pose.pose; }
    [[nodiscard]] Ray ray(std::uint64_t column, std::uint64_t row) const {
        return ray_at(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5);
    }
    /// Through a point of the image, in pixels from its upper left corner.
    [[nodiscard]] Ray ray_at(double x, double y) const {
        Ray ray = sensor_pose.ray({0, 0, -1});
        ray.origin = sensor_pose.pose.point(
            {(x / size.width - 0.5) * width, (0.5 - y / size.height) * height, 0});
        return ray;
    }
    [[nodiscard]] RayCone cone() const { return {static_cast<float>(height / size.height), 0}; }
};

/// All around: columns divide 360 degrees of azimuth from behind over the left, rows 180 degrees of
/// elevation from the top; the middle of the image looks ahead.
class Equirectangular {
public:
    Equirectangular(const SensorPose& sensor_pose, ImageSize size);
    [[nodiscard]] const ImageSize& rays() const { return size_; }
    [[nodiscard]] const Pose& pose(std::uint64_t, std::uint64_t) const { return sensor_pose_.pose; }
    [[nodiscard]] Ray ray(std::uint64_t column, std::uint64_t row) const {
        const glm::dvec2& azimuth = columns_[column];
        const glm::dvec2& elevation = rows_[row];
        return sensor_pose_.ray({elevation.x * azimuth.y, elevation.y, -elevation.x * azimuth.x});
    }
    [[nodiscard]] RayCone cone() const {
        return {0, 2.0F * std::numbers::pi_v<float> / static_cast<float>(size_.width)};
    }

private:
    SensorPose sensor_pose_;
    ImageSize size_;
    std::vector<glm::dvec2> columns_, rows_;  ///< cosine and sine
};

/// One beam of a lidar.
struct LidarChannel {
    double elevation = 0;         ///< degrees above the plane of x and y
    double azimuth_offset = 0;    ///< degrees
    glm::dvec3 origin_offset{0};  ///< turns with the head: x along its azimuth
};
/// The same, ready for rays.
struct LidarBeam {
    explicit LidarBeam(const LidarChannel& channel);
    /// The ray while the head is turned so far: its cosine and sine.
    [[nodiscard]] Ray ray(const SensorPose& sensor_pose, const glm::dvec2& head) const {
        const double cosine = head.x * offset.x - head.y * offset.y;
        const double sine = head.y * offset.x + head.x * offset.y;
        Ray ray = sensor_pose.ray({elevation.x * cosine, elevation.x * sine, elevation.y});
        ray.origin = sensor_pose.pose.point(
            {at.x * head.x - at.y * head.y, at.x * head.y + at.y * head.x, at.z});
        return ray;
    }

    glm::dvec2 elevation, offset;  ///< cosine and sine
    glm::dvec3 at;                 ///< in the head
};
/// The angle between the first two azimuths of a head, by their cosines and sines; 0 without two.
[[nodiscard]] float step_of(std::span<const glm::dvec2> heads);
/// A head that turns about z: `count` azimuths divide [start, stop) degrees, counter-clockwise seen
/// from above, 0 is ahead. Ray c * count + a is that of channel c at azimuth a; directions have
/// unit length.
class Lidar {
public:
    Lidar(const SensorPose& sensor_pose, std::span<const LidarChannel> channels, double start,
          double stop, std::uint32_t count);
    [[nodiscard]] ImageSize rays() const {
        return {static_cast<std::uint32_t>(heads_.size()),
                static_cast<std::uint32_t>(beams_.size())};
    }
    [[nodiscard]] const Pose& pose(std::uint64_t, std::uint64_t) const { return sensor_pose_.pose; }
    [[nodiscard]] Ray ray(std::uint64_t azimuth, std::uint64_t channel) const {
        return beams_[channel].ray(sensor_pose_, heads_[azimuth]);
    }
    [[nodiscard]] RayCone cone() const { return {0, step_of(heads_)}; }

private:
    SensorPose sensor_pose_;
    std::vector<LidarBeam> beams_;
    std::vector<glm::dvec2> heads_;  ///< cosine and sine
};

/// A lidar in motion: scan after scan, and in a scan as Lidar, but each column leaves from where the
/// sensor is at its time. Azimuths are any, in degrees.
class Sweep {
public:
    /// `poses` has one for each column of each scan; only the range of `limits` counts.
    Sweep(const SensorPose& limits, std::span<const LidarChannel> channels,
          std::span<const double> azimuths, std::vector<Pose> poses);
    [[nodiscard]] ImageSize rays() const {
        return {static_cast<std::uint32_t>(heads_.size()),
                static_cast<std::uint32_t>(poses_.size() / heads_.size() * beams_.size())};
    }
    [[nodiscard]] const Pose& pose(std::uint64_t column, std::uint64_t row) const {
        return poses_[row / beams_.size() * heads_.size() + column];
    }
    [[nodiscard]] Ray ray(std::uint64_t column, std::uint64_t row) const {
        return beams_[row % beams_.size()].ray({pose(column, row), tmin_, tmax_}, heads_[column]);
    }
    [[nodiscard]] RayCone cone() const { return {0, step_of(heads_)}; }

private:
    float tmin_, tmax_;
    std::vector<LidarBeam> beams_;
    std::vector<glm::dvec2> heads_;  ///< cosine and sine
    std::vector<Pose> poses_;
};

/// A camera in motion that reads its picture row by row: each row leaves from where the camera is at
/// its time.
class RollingShutter {
public:
    /// `poses` has one for each row; that of `camera` does not count.
    RollingShutter(const Pinhole& camera, std::vector<Pose> poses)
        : camera_(camera),
          poses_(std::move(poses)) {}
    [[nodiscard]] const ImageSize& rays() const { return camera_.size; }
    [[nodiscard]] const Pose& pose(std::uint64_t, std::uint64_t row) const { return poses_[row]; }
    [[nodiscard]] Ray ray(std::uint64_t column, std::uint64_t row) const {
        Pinhole camera = camera_;
        camera.sensor_pose.pose = poses_[row];
        return camera.ray(column, row);
    }
    [[nodiscard]] RayCone cone() const { return camera_.cone(); }

private:
    Pinhole camera_;
    std::vector<Pose> poses_;
};

using Sensor = std::variant<Pinhole, Orthographic, Equirectangular, Lidar, Sweep, RollingShutter>;

/// The rays of a picture that this camera takes: a Pinhole, or for an orthographic camera parallel
/// rays, whose pixels are square and show at least xmag and ymag.
[[nodiscard]] Sensor camera_sensor(const Camera& camera, const SensorPose& limits, ImageSize size);

/// Rays come row by row: of an image from the top, of a lidar channel by channel.
[[nodiscard]] ImageSize ray_grid(const Sensor& sensor);
[[nodiscard]] std::uint64_t ray_count(const Sensor& sensor);
/// Each sensor has its own: one without it does not compile.
[[nodiscard]] RayCone cone_of(const Sensor& sensor);
/// Where the sensor stands when it measures a ray.
[[nodiscard]] Pose pose_of_ray(const Sensor& sensor, std::uint64_t ray);
/// Rays [first, first + out.size()).
void generate_rays(const Sensor& sensor, std::uint64_t first, std::span<Ray> out);
/// Rays of these numbers, as many as `out` takes.
void generate_rays(const Sensor& sensor, std::span<const std::uint64_t> numbers,
                   std::span<Ray> out);
/// Pixels of a sensor's picture, by default all of them: `size` from column x and row y on.
struct PixelWindow {
    std::uint32_t x = 0, y = 0;
    ImageSize size = {};  ///< 0: the whole picture
    [[nodiscard]] bool is_whole() const { return size.width == 0; }
    [[nodiscard]] ImageSize size_of(const Sensor& sensor) const {
        return is_whole() ? ray_grid(sensor) : size;
    }
};
/// The same in the tile order of the window (geometry/tile_order.h).
void generate_tiles(const Sensor& sensor, std::uint64_t first, std::span<Ray> out,
                    const PixelWindow& window = {});
/// Rays of pixels from place `first` of the tile order on, `samples` each: the first one through
/// the centre, as generate_tiles() makes it; others of a Pinhole or Orthographic spread evenly over
/// the pixel. out.size() is a multiple of `samples`.
void generate_samples(const Sensor& sensor, std::uint32_t samples, std::uint64_t first,
                      std::span<Ray> out, const PixelWindow& window = {});

/// Rays from given points over the hemisphere of a normal, cosine-weighted: their mean of a
/// function of the direction is its integral over the projected solid angle.
///
/// The directions of a point are a Fibonacci lattice on the unit square, shifted at random by two
/// numbers that depend on the seed and the point alone, and mapped to the hemisphere.
struct Hemisphere {
    std::uint32_t samples = 1;  ///< rays per point
    std::uint64_t seed = 0;
    /// Distance along the normal at which rays start, so that they leave the surface
    double margin = 0;
    /// Starts rays of each point beyond what float32 tells apart along its normal, where that is
    /// farther.
    bool beyond_rounding = false;
};
/// Rays [first, first + out.size()) of all points' rays, sample by sample of point after point.
/// `points` are those from number `first_point` on: origin, tmin, normal of any length, tmax. A
/// point without a normal has invalid rays.
void generate_rays(const Hemisphere& hemisphere, std::span<const Ray> points,
                   std::uint64_t first_point, std::uint64_t first, std::span<Ray> out);

}  // namespace raynest
