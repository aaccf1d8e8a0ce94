#include "engine/integrators/integrator.h"

#include "engine/geometry/sphere_shape.h"
#include "engine/integrators/surface_point.h"
#include "engine/math/random.h"
#include "tests/unit/engine/integrators/kernel_caster.h"
#include "tests/unit/engine/integrators/same_bytes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <numbers>
#include <vector>

using namespace raynest;
using test::same_bytes;

namespace {

/// A scene, a camera that frames it, and an integrator.
struct Studio {
    explicit Studio(const SceneDescription& description, const IntegratorSettings& settings = {},
                    const CameraRequest& asked = {})
        : scene(test::build_scene(description)),
          camera(camera_sensor(*choose_camera(*scene, asked), {}, {33, 21})),
          caster(scene->view()) {
        source.scene = &scene->view();
        // Spheres are the only records of these tests.
        source.record_normal = [](std::uint32_t, const void*) -> RecordNormal {
            return [](const void* record, const float* point, float normal[3]) noexcept {
                const Vec3& center = static_cast<const Sphere*>(record)->center;
                for (int c = 0; c < 3; ++c) normal[c] = point[c] - center[c];
            };
        };
        auto made = make_integrator("ao", {source, scene->bounds()}, settings);
        REQUIRE(made);
        integrator = std::move(*made);
    }
    void add(Film& film, std::uint64_t first_pixel, std::uint64_t pixels, std::uint32_t first,
             std::uint32_t samples, std::uint64_t seed = 1) {
        REQUIRE(add_samples(*integrator, {camera, first_pixel, pixels, first, samples, seed},
                            caster, arrays, film));
    }
    std::shared_ptr<const Snapshot> scene;
    Sensor camera;
    ColumnSource source;
    std::unique_ptr<const Integrator> integrator;
    test::KernelCaster caster;
    Wavefront arrays;
};

constexpr std::uint64_t pixel_count = 33 * 21;

/// Nested placements, turned and scaled, `far` away from the origin.
SceneDescription far_tree(float far) {
    SceneDescription scene = test::tree_scene();
    for (InstanceDescription& instance : scene.objects[2].instances) {
        instance.transform.m[3] += far;
        instance.transform.m[11] -= far / 3;
    }
    scene.objects[1].instances[0].transform = test::rotation(0.7F);
    scene.objects[1].instances[0].transform.m[7] = 2;
    return scene;
}

}  // namespace

TEST_CASE("a picture has the same bytes in passes, in chunks and at once") {
    Studio studio(test::tree_scene());
    Film at_once({33, 21});
    studio.add(at_once, 0, pixel_count, 0, 8);
    Film passes({33, 21});
    for (std::uint32_t s = 0; s < 8; s += 2) studio.add(passes, 0, pixel_count, s, 2);
    CHECK(same_bytes(at_once, passes));
    Film chunks({33, 21});
    for (std::uint64_t first = 0; first < pixel_count; first += 100)
        studio.add(chunks, first, std::min<std::uint64_t>(100, pixel_count - first), 0, 8);
    CHECK(same_bytes(at_once, chunks));
    Film other({33, 21});
    studio.add(other, 0, pixel_count, 0, 8, 2);
    CHECK_FALSE(same_bytes(at_once, other));
}

TEST_CASE("open surfaces are white, and a film shows what its camera rays met") {
    SceneDescription one;
    one.objects.resize(1);
    one.objects[0].geometries = {test::unit_square(0)};
    one.materials.resize(1);
    Studio studio(one);
    Film film({33, 21});
    studio.add(film, 0, pixel_count, 0, 4);
    std::size_t hits = 0;
    for (std::uint64_t i = 0; i < pixel_count; ++i) {
        const Vec4 colour = film.colour(i);
        CHECK(colour.x == doctest::Approx(colour.w));  // premultiplied white
        if (film.words(FilmLayer::mesh)[i] == no_id) {
            CHECK(film.floats(FilmLayer::z)[i] == film_depth_miss);
            continue;
        }
        ++hits;
        CHECK(film.words(FilmLayer::instance)[i] == 0);
        CHECK(film.words(FilmLayer::material)[i] == 0);
        CHECK(std::abs(film.floats(FilmLayer::p_z)[i]) < 1e-5F);
        CHECK(film.floats(FilmLayer::n_z)[i] >= 0.2F);
    }
    CHECK(hits > 20);
}

TEST_CASE("a sphere above a sphere hides the square of its apparent size") {
    SceneDescription two;
    two.objects.resize(1);
    ObjectDescription& object = two.objects[0];
    object.record_type = "sphere";
    const std::array spheres{Sphere{Vec3(0), 1}, Sphere{Vec3(4, 0, 0), 1}};
    object.records.resize(sizeof spheres);
    std::memcpy(object.records.data(), spheres.data(), sizeof spheres);
    for (const Sphere& sphere : spheres) object.record_bounds.push_back(bounds(sphere));
    const auto openness = [&](const glm::dvec3& eye, const glm::dvec3& at, float distance) {
        CameraRequest camera;
        camera.look_at = true;
        camera.eye = eye;
        camera.at = at;
        camera.fov_degrees = 1;
        Studio studio(two, {.ao_distance = distance}, camera);
        Film film({33, 21});
        studio.add(film, 0, pixel_count, 0, 64);
        double sum = 0;
        for (std::uint64_t i = 0; i < pixel_count; ++i)
            sum += static_cast<double>(film.colour(i).x);
        return sum / pixel_count;
    };
    // Three standard errors of 693 * 64 samples.
    constexpr double error = 0.0045;
    // The other's centre is 3 away, straight above: 1/9 of the cosine-weighted sky.
    CHECK(std::abs(openness({2, 0, 0}, {1, 0, 0}, 10) - 8.0 / 9) < error);
    CHECK(openness({2, 0, 0}, {1, 0, 0}, 1.9F) == 1);
    // On the far side, and from beside the other one, nothing is above.
    CHECK(openness({-2, 0, 0}, {-1, 0, 0}, 10) == 1);
    CHECK(openness({0, 3, 0}, {0, 1, 0}, 10) == 1);
}

TEST_CASE("a ray that leaves a surface by its lift does not meet it again, near and far") {
    for (const float far : {0.0F, 1000.0F, 1e6F}) {
        CAPTURE(far);
        Studio studio(far_tree(far));
        SampleRange range{studio.camera, 0, pixel_count, 0, 512, 1};
        REQUIRE(cast_camera_rays(range, studio.caster, studio.arrays));
        std::vector<Ray> lifted;
        std::vector<Ray> resting;
        std::vector<std::uint64_t> paths;
        for (std::size_t i = 0; i < studio.arrays.hits.size(); ++i) {
            const HitRecord& hit = studio.arrays.hits[i];
            if (hit.hit == 0) continue;
            const SurfacePoint point = surface_point(studio.source, studio.arrays.rays[i], hit);
            const Vec2 random = sampler_of(range, studio.arrays, i).pair(1);
            for (const Vec3& side : {point.normal, -point.normal}) {
                const Vec3 direction = cosine_direction(side, random);
                lifted.push_back({point.origin(direction), 0, direction});
                resting.push_back({Vec3(point.position), 0, direction});
                paths.push_back(hit.path << 32 | hit.triangle / 2);
            }
        }
        REQUIRE(lifted.size() > 1000);
        const auto again = [&](const std::vector<Ray>& rays) {
            std::vector<HitRecord> hits(rays.size());
            REQUIRE(studio.caster.closest(rays, hits));
            std::size_t count = 0;
            for (std::size_t i = 0; i < hits.size(); ++i)
                if (hits[i].hit != 0 && (hits[i].path << 32 | hits[i].triangle / 2) == paths[i])
                    ++count;
            return count;
        };
        CHECK(again(lifted) == 0);
        if (far > 0) CHECK(again(resting) > 0);
    }
}

namespace {

/// A closed prism over a triangle with a right angle and another angle of so many degrees.
GeometryDescription prism(double degrees) {
    const auto width = static_cast<float>(2 / std::tan(degrees * std::numbers::pi / 180));
    GeometryDescription shape;
    for (const float z : {-1.5F, 1.5F})
        for (const Vec2& corner : {Vec2(0, 0), Vec2(width, 0), Vec2(0, 2)})
            shape.positions.emplace_back(corner, z);
    shape.indices = {0, 2, 1, 3, 4, 5, 0, 1, 4, 0, 4, 3, 1, 2, 5, 1, 5, 4, 2, 0, 3, 2, 3, 5};
    return shape;
}

}  // namespace

TEST_CASE("a ray that leaves a wall of a closed room meets another one, from the edges, too") {
    const double turn = 0.4;
    const auto c = static_cast<float>(std::cos(turn)), s = static_cast<float>(std::sin(turn));
    for (const double degrees : {60.0, 45.0, 30.0}) {
        for (const float far : {0.0F, 1000.0F}) {
            for (const bool turned : {false, true}) {
                CAPTURE(degrees);
                CAPTURE(far);
                CAPTURE(turned);
                Transform place = test::translation(far, -far, 2 * far);
                if (turned)
                    place = {{c * c, -s, c * s, far, c * s, c, s * s, -far, -s, 0, c, 2 * far}};
                SceneDescription description;
                description.objects.resize(2);
                description.objects[0].geometries = {prism(degrees)};
                description.objects[1].instances = {test::place(0, place)};
                description.root = 1;
                Studio studio(description);
                const GeometryDescription& shape = description.objects[0].geometries[0];
                Vec3 middle(0);
                for (const Vec3& corner : shape.positions) middle += corner / 6.0F;
                const std::array<float, 12>& m = place.m;
                const Vec3 inside(m[0] * middle.x + m[1] * middle.y + m[2] * middle.z + m[3],
                                  m[4] * middle.x + m[5] * middle.y + m[6] * middle.z + m[7],
                                  m[8] * middle.x + m[9] * middle.y + m[10] * middle.z + m[11]);
                std::vector<Ray> rays;
                Random random(7);
                for (int i = 0; i < 40000; ++i) {
                    HitRecord hit;
                    hit.hit = 1;
                    hit.object = 0;
                    hit.path = 0;
                    hit.triangle = static_cast<std::uint32_t>(i % 8);
                    const float along = random.uniform();
                    const float away = i % 3 == 0 ? 0 : 1e-6F * random.uniform();
                    const int edge = i / 8 % 3;
                    hit.u = edge == 0 ? away : edge == 1 ? along : (1 - away) * along;
                    hit.v = edge == 0 ? along : edge == 1 ? away : 1 - away - hit.u;
                    hit.v = std::clamp(hit.v, 0.0F, 1 - hit.u);
                    const SurfacePoint point = surface_point(studio.source, Ray{}, hit);
                    const Vec3 to_middle = inside - Vec3(point.position);
                    const Vec3 side =
                        glm::dot(to_middle, point.normal) > 0 ? point.normal : -point.normal;
                    const float u = random.uniform();
                    const Vec3 direction = cosine_direction(side, {u, random.uniform()});
                    rays.push_back({point.origin(direction), 0, direction});
                }
                std::vector<HitRecord> hits(rays.size());
                REQUIRE(studio.caster.closest(rays, hits));
                std::size_t leaks = 0;
                for (const HitRecord& hit : hits) leaks += hit.hit == 0 ? 1U : 0U;
                CHECK(leaks == 0);
            }
        }
    }
}

TEST_CASE("an unknown integrator is refused with the names there are") {
    Studio studio(test::tree_scene());
    const auto none = make_integrator("aoo", {studio.source, studio.scene->bounds()}, {});
    REQUIRE(!none);
    CHECK(none.error().message.find("ao") != std::string::npos);
}
