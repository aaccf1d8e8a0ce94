#include "engine/integrators/generators.h"

#include "engine/math/float_step.h"
#include "engine/math/random.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace raynest {
namespace {

constexpr double full_turn = 2 * std::numbers::pi;

glm::dvec2 cosine_and_sine(double angle) {
    return {std::cos(angle), std::sin(angle)};
}

/// The two axes that make a right-handed frame with a unit z (Duff et al., "Building an orthonormal
/// basis, revisited", 2017).
struct Axes {
    glm::dvec3 x, y, z;
    explicit Axes(const glm::dvec3& n) : z(n) {
        const double sign = std::copysign(1.0, n.z);
        const double a = -1 / (sign + n.z);
        const double b = n.x * n.y * a;
        x = {1 + sign * n.x * n.x * a, sign * b, -sign * n.x};
        y = {b, sign + n.y * n.y * a, -n.y};
    }
};

/// Returns the distance along a unit normal between points that float32 tells apart here. It is far
/// below the point's distance from zero where the normal is along an axis of small coordinates.
double step_along(const Vec3& point, const glm::dvec3& normal) {
    double step = 0;
    for (int axis = 0; axis < 3; ++axis) step += std::abs(normal[axis]) * float_step(point[axis]);
    return step;
}

double fraction(double x) {
    return x - std::floor(x);
}

}  // namespace

Pose pose_of(const Transform& to_world) {
    const auto& m = to_world.m;
    return {{m[0], m[4], m[8]}, {m[1], m[5], m[9]}, {m[2], m[6], m[10]}, {m[3], m[7], m[11]}};
}

Pinhole pinhole(const Camera& camera, ImageSize size) {
    const double half_height = 0.5 * size.height;
    const double step = std::tan(static_cast<double>(camera.yfov) / 2) / half_height;
    return {{pose_of(camera.to_world)}, size, 0.5 * size.width, half_height, step, step};
}

Sensor camera_sensor(const Camera& camera, const SensorPose& limits, ImageSize size) {
    const SensorPose sensor_pose{pose_of(camera.to_world), limits.tmin, limits.tmax};
    if (camera.ymag == 0) {
        Pinhole sensor = pinhole(camera, size);
        sensor.sensor_pose = sensor_pose;
        return sensor;
    }
    const double ymag = camera.ymag;
    const double aspect = static_cast<double>(size.width) / size.height;
    const double height = 2 * std::max(ymag, ymag * static_cast<double>(camera.aspect) / aspect);
    return Orthographic{sensor_pose, size, aspect * height, height};
}

Equirectangular::Equirectangular(const SensorPose& sensor_pose, ImageSize size)
    : sensor_pose_(sensor_pose),
      size_(size) {
    for (std::uint32_t i = 0; i < size.width; ++i)
        columns_.push_back(cosine_and_sine(((i + 0.5) / size.width - 0.5) * full_turn));
    for (std::uint32_t i = 0; i < size.height; ++i)
        rows_.push_back(cosine_and_sine((0.5 - (i + 0.5) / size.height) * std::numbers::pi));
}

LidarBeam::LidarBeam(const LidarChannel& channel)
    : elevation(cosine_and_sine(channel.elevation * degree)),
      offset(cosine_and_sine(channel.azimuth_offset * degree)),
      at(channel.origin_offset) {}

float step_of(std::span<const glm::dvec2> heads) {
    if (heads.size() < 2) return 0;
    const glm::dvec2 &a = heads[0], &b = heads[1];
    return static_cast<float>(std::abs(std::atan2(a.x * b.y - a.y * b.x, glm::dot(a, b))));
}

Lidar::Lidar(const SensorPose& sensor_pose, std::span<const LidarChannel> channels, double start,
             double stop, std::uint32_t count)
    : sensor_pose_(sensor_pose),
      beams_(channels.begin(), channels.end()) {
    for (std::uint32_t i = 0; i < count; ++i)
        heads_.push_back(cosine_and_sine((start + (stop - start) * i / count) * degree));
}

Sweep::Sweep(const SensorPose& limits, std::span<const LidarChannel> channels,
             std::span<const double> azimuths, std::vector<Pose> poses)
    : tmin_(limits.tmin),
      tmax_(limits.tmax),
      beams_(channels.begin(), channels.end()),
      poses_(std::move(poses)) {
    for (const double azimuth : azimuths) heads_.push_back(cosine_and_sine(azimuth * degree));
}

ImageSize ray_grid(const Sensor& sensor) {
    return std::visit(
        [](const auto& kind) {
            if constexpr (requires { kind.size; })
                return kind.size;
            else
                return kind.rays();
        },
        sensor);
}

std::uint64_t ray_count(const Sensor& sensor) {
    return ray_grid(sensor).pixels();
}

RayCone cone_of(const Sensor& sensor) {
    return std::visit([](const auto& kind) { return kind.cone(); }, sensor);
}

Pose pose_of_ray(const Sensor& sensor, std::uint64_t ray) {
    const std::uint64_t width = ray_grid(sensor).width;
    return std::visit(
        [&](const auto& kind) -> Pose {
            if constexpr (std::is_same_v<decltype(kind), const Pinhole&>)
                return kind.sensor_pose.pose;
            else
                return kind.pose(ray % width, ray / width);
        },
        sensor);
}

void generate_rays(const Sensor& sensor, std::uint64_t first, std::span<Ray> out) {
    const std::uint64_t width = ray_grid(sensor).width;
    std::visit(
        [&](const auto& kind) {
            std::uint64_t column = first % width;
            std::uint64_t row = first / width;
            for (Ray& ray : out) {
                ray = kind.ray(column, row);
                if (++column == width) column = 0, ++row;
            }
        },
        sensor);
}

void generate_rays(const Sensor& sensor, std::span<const std::uint64_t> numbers,
                   std::span<Ray> out) {
    const std::uint64_t width = ray_grid(sensor).width;
    std::visit(
        [&](const auto& kind) {
            for (std::size_t i = 0; i < out.size(); ++i)
                out[i] = kind.ray(numbers[i] % width, numbers[i] / width);
        },
        sensor);
}

void generate_tiles(const Sensor& sensor, std::uint64_t first, std::span<Ray> out,
                    const PixelWindow& window) {
    const ImageSize size = window.size_of(sensor);
    std::visit(
        [&](const auto& kind) {
            for_each_in_tiles(first, out.size(), size.width, size.height,
                              [&](std::uint64_t i, std::uint64_t column, std::uint64_t row) {
                                  out[i] = kind.ray(window.x + column, window.y + row);
                              });
        },
        sensor);
}

void generate_samples(const Sensor& sensor, std::uint32_t samples, std::uint64_t first,
                      std::span<Ray> out, const PixelWindow& window) {
    if (samples == 1) return generate_tiles(sensor, first, out, window);
    // The R2 sequence, which begins at the centre: any number of its points is spread evenly.
    constexpr double step_x = 0.7548776662466927;
    constexpr double step_y = 0.5698402909980532;
    const ImageSize size = window.size_of(sensor);
    const auto rays = [&](const auto& kind) {
        for_each_in_tiles(first, out.size() / samples, size.width, size.height,
                          [&](std::uint64_t i, std::uint64_t x_in, std::uint64_t y_in) {
                              const std::uint64_t column = window.x + x_in, row = window.y + y_in;
                              for (std::uint32_t s = 0; s < samples; ++s) {
                                  Ray& ray = out[i * samples + s];
                                  if constexpr (requires { kind.ray_at(0.5, 0.5); }) {
                                      const double x = fraction(0.5 + s * step_x);
                                      const double y = fraction(0.5 + s * step_y);
                                      ray = kind.ray_at(static_cast<double>(column) + x,
                                                        static_cast<double>(row) + y);
                                  } else {
                                      ray = kind.ray(column, row);
                                  }
                              }
                          });
    };
    std::visit(rays, sensor);
}

void generate_rays(const Hemisphere& hemisphere, std::span<const Ray> points,
                   std::uint64_t first_point, std::uint64_t first, std::span<Ray> out) {
    constexpr double golden = 0.6180339887498949;  // (sqrt(5) - 1) / 2
    const std::uint64_t samples = hemisphere.samples;
    for (std::size_t i = 0; i < out.size();) {
        const std::uint64_t number = (first + i) / samples;
        const Ray& point = points[number - first_point];
        Random random(hemisphere.seed);
        random.skip(2 * number);
        const double shift_u = static_cast<double>(random.uniform());
        const double shift_v = static_cast<double>(random.uniform());
        const Axes frame(glm::normalize(glm::dvec3(point.direction)));
        const double margin = hemisphere.beyond_rounding
                                  ? std::max(hemisphere.margin, step_along(point.origin, frame.z))
                                  : hemisphere.margin;
        const Vec3 origin(glm::dvec3(point.origin) + margin * frame.z);
        for (std::uint64_t s = (first + i) % samples; s < samples && i < out.size(); ++s, ++i) {
            const auto k = static_cast<double>(s);
            const double u = fraction((k + 0.5) / static_cast<double>(samples) + shift_u);
            const double v = fraction(k * golden + shift_v);
            const double radius = std::sqrt(u);
            const glm::dvec2 around = radius * cosine_and_sine(full_turn * v);
            out[i] = point;
            out[i].origin = origin;
            out[i].direction =
                Vec3(frame.x * around.x + frame.y * around.y + frame.z * std::sqrt(1 - u));
        }
    }
}

}  // namespace raynest
