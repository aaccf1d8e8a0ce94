// Tests a property of every generator: chunks, tiles and whole sets have the same rays.
// tests/integration/generators_test.py compares the rays with PROTOCOL.md, using numpy.
#include "engine/integrators/generators.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <vector>

using namespace raynest;

namespace {

const SensorPose sensor_pose{pose_of(Transform{{0, 0, 1, 5, 1, 0, 0, 6, 0, 1, 0, 7}}), 0.5F,
                             100.0F};

std::vector<Sensor> sensors() {
    constexpr ImageSize size{37, 21};
    std::array<LidarChannel, 11> channels;  // not a whole number of tiles
    for (std::size_t i = 0; i < channels.size(); ++i)
        channels[i].elevation = 2 * static_cast<double>(i) - 10;
    channels[0] = {-10, 0.5, Vec3(0.1F, 0, 0)};
    channels[1].azimuth_offset = -0.5;
    channels[10].origin_offset = Vec3(0, 0, 0.2F);
    return {Pinhole{sensor_pose, size, 18, 11, 0.02, 0.03}, Orthographic{sensor_pose, size, 4, 3},
            Equirectangular(sensor_pose, size), Lidar(sensor_pose, channels, -90, 90, 250)};
}

std::vector<Ray> all_rays(const Sensor& sensor) {
    std::vector<Ray> rays(ray_count(sensor));
    generate_rays(sensor, 0, rays);
    return rays;
}

bool same(const Ray& a, const Ray& b) {
    return std::memcmp(&a, &b, sizeof(Ray)) == 0;
}

}  // namespace

TEST_CASE("a chunk of rays equals the same rays of the whole set") {
    for (const Sensor& sensor : sensors()) {
        CAPTURE(sensor.index());
        const std::vector<Ray> all = all_rays(sensor);
        std::vector<Ray> part(100);
        generate_rays(sensor, 77, part);
        for (std::size_t i = 0; i < part.size(); ++i) CHECK(same(part[i], all[77 + i]));
        CHECK(std::all_of(all.begin(), all.end(), [](const Ray& ray) {
            return is_valid(ray) && ray.tmin == 0.5F && ray.tmax == 100.0F;
        }));
    }
}

TEST_CASE("tiles are the same rays in tile order") {
    for (const Sensor& sensor : sensors()) {
        const ImageSize size = ray_grid(sensor);
        const std::vector<Ray> all = all_rays(sensor);
        const std::size_t first = std::size_t{8} * size.width;
        std::vector<Ray> rest(all.size() - first);
        generate_tiles(sensor, first, rest);
        for (std::size_t i = 0; i < rest.size(); ++i)
            CHECK(same(rest[i], all[tile_order(first + i, size.width, size.height)]));
    }
}

TEST_CASE("an image has a ray per pixel, a lidar one per channel and azimuth") {
    for (const Sensor& sensor : sensors()) {
        const bool lidar = std::holds_alternative<Lidar>(sensor);
        CHECK(ray_grid(sensor).width == (lidar ? 250 : 37));
        CHECK(ray_count(sensor) == (lidar ? 11 * 250 : 37 * 21));
    }
}

TEST_CASE(
    "hemisphere rays are unit, on the side of the normal, cosine-weighted, and cut anywhere") {
    constexpr std::uint64_t samples = 1000;
    std::vector<Ray> points = {{Vec3(1, 2, 3), 0.25F, Vec3(0, 0, -2), 9},
                               {Vec3(0), 0, Vec3(3, -4, 1)},
                               {Vec3(0), 0, Vec3(0, 1, 0)}};
    std::vector<Ray> all(points.size() * samples);
    generate_rays(Hemisphere{samples, 7}, points, 10, 10 * samples, all);
    for (std::size_t p = 0; p < points.size(); ++p) {
        const glm::dvec3 normal = glm::normalize(glm::dvec3(points[p].direction));
        double cosines = 0;
        for (std::size_t s = 0; s < samples; ++s) {
            const Ray& ray = all[p * samples + s];
            CHECK(ray.origin == points[p].origin);
            CHECK(ray.tmin == points[p].tmin);
            CHECK(ray.tmax == points[p].tmax);
            const glm::dvec3 direction(ray.direction);
            CHECK(std::abs(glm::length(direction) - 1) < 1e-6);
            const double cosine = glm::dot(direction, normal);
            CHECK(cosine > 0);
            cosines += cosine;
        }
        CHECK(std::abs(cosines / samples - 2.0 / 3) < 0.002);  // random samples would miss by 0.007
    }
    std::vector<Ray> part(1500);
    generate_rays(Hemisphere{samples, 7}, std::span(points).subspan(1), 11, 11 * samples + 300,
                  part);
    for (std::size_t i = 0; i < part.size(); ++i) CHECK(same(part[i], all[samples + 300 + i]));

    // Beyond rounding: a step of float32 along the normal, where that is more than the margin.
    const std::vector<Ray> far = {{Vec3(5e6F, 1, 0), 0, Vec3(1, 0, 0), 9},
                                  {Vec3(5e6F, 1, 0), 0, Vec3(0, 0, 2), 9}};
    for (const bool beyond : {false, true}) {
        std::array<Ray, 2> starts;
        generate_rays(Hemisphere{1, 7, 1e-3, beyond}, far, 0, 0, starts);
        CHECK(starts[0].origin.x == (beyond ? 5e6F + 0.5F : 5e6F));
        CHECK(starts[1].origin == Vec3(5e6F, 1, 1e-3F));
    }

    std::vector<Ray> other(samples);
    generate_rays(Hemisphere{samples, 8}, points, 10, 10 * samples, other);
    CHECK_FALSE(same(other[0], all[0]));
    points[0].direction = Vec3(0);
    generate_rays(Hemisphere{samples, 7}, points, 10, 10 * samples, other);
    CHECK(std::none_of(other.begin(), other.end(), is_valid));
}

TEST_CASE("the cone of a sensor is the room between neighbouring rays") {
    for (const Sensor& sensor : sensors()) {
        const ImageSize grid = ray_grid(sensor);
        const std::vector<Ray> rays = all_rays(sensor);
        // Near the middle, where directions of a pinhole are about as long as they are far apart.
        const std::size_t middle = (grid.height / 2) * std::size_t{grid.width} + grid.width / 2;
        const bool by_rows = std::holds_alternative<Pinhole>(sensor);
        const Ray &a = rays[middle], &b = rays[middle + (by_rows ? grid.width : 1)];
        const RayCone cone = cone_of(sensor);
        CAPTURE(sensor.index());
        if (std::holds_alternative<Orthographic>(sensor)) {
            const Ray& below = rays[middle + grid.width];
            CHECK(cone.width == doctest::Approx(glm::length(below.origin - a.origin)));
            CHECK(cone.spread == 0);
        } else {
            CHECK(cone.spread ==
                  doctest::Approx(glm::length(b.direction - a.direction)).epsilon(0.02));
            CHECK(cone.width == 0);
        }
    }
    const Pinhole camera{sensor_pose, {4, 2}, 2, 1, 0.02, 0.03};
    CHECK(cone_of(RollingShutter(camera, std::vector<Pose>(2))).spread == cone_of(camera).spread);
    const std::array<double, 2> azimuths = {359.5, 0.5};
    const std::array<LidarChannel, 1> channels{};
    CHECK(cone_of(Sweep(sensor_pose, channels, azimuths, std::vector<Pose>(2))).spread ==
          doctest::Approx(3.14159 / 180));
}
