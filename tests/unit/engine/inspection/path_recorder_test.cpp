// The rays of a path: recording changes no sample, and each ray begins where the one before ended.
#include "engine/inspection/path_recorder.h"

#include "engine/assets/builtin/builtin.h"
#include "engine/integrators/integrator.h"
#include "tests/unit/engine/integrators/kernel_caster.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <vector>

using namespace raynest;

namespace {

/// Two trees under a sky: paths meet surfaces, leave, and find their light blocked.
struct Studio {
    explicit Studio(const char* integrator)
        : scene(test::build_scene(*describe_builtin("builtin:forest?trees=2"))),
          camera(camera_sensor(*choose_camera(*scene, {}), {}, {24, 16})),
          caster(scene->view()) {
        IntegratorScene in{{}, scene->bounds(), &scene->shading()};
        in.source.scene = &scene->view();
        auto made = make_integrator(integrator, in, {});
        REQUIRE(made);
        light = std::move(*made);
    }
    FilmSample sample(std::uint64_t pixel, std::uint32_t number, RayCaster& by) {
        FilmSample out;
        REQUIRE(light->render({camera, pixel, 1, number, 1, 3}, by, arrays, {&out, 1}));
        return out;
    }
    std::shared_ptr<const Snapshot> scene;
    Sensor camera;
    test::KernelCaster caster;
    std::unique_ptr<const Integrator> light;
    Wavefront arrays;
};

}  // namespace

TEST_CASE("a recorded sample is that of the picture, and its rays follow each other") {
    for (const char* integrator : {"path", "direct", "ao"}) {
        CAPTURE(integrator);
        Studio studio(integrator);
        std::size_t bounces = 0, reached = 0, blocked = 0;
        for (std::uint64_t pixel = 0; pixel < std::uint64_t{24} * 16; ++pixel) {
            PathRecorder recorder(studio.caster);
            const FilmSample told = studio.sample(pixel, 5, recorder);
            const FilmSample plain = studio.sample(pixel, 5, studio.caster);
            CHECK(told.radiance == plain.radiance);
            const std::vector<PathRay>& rays = recorder.rays();
            REQUIRE_FALSE(rays.empty());
            CHECK(rays[0].kind == PathRayKind::camera);
            CHECK(rays[0].parent == no_id);
            for (std::size_t i = 1; i < rays.size(); ++i) {
                const PathRay& ray = rays[i];
                REQUIRE(ray.parent < i);
                const PathRay& from = rays[ray.parent];
                CHECK(ray.kind != PathRayKind::camera);
                CHECK(from.kind != PathRayKind::shadow);
                CHECK(from.hit.hit == 1);
                CHECK(ray.bounce == from.bounce + 1);
                const Vec3 start = point_along(from.ray.origin, from.ray.direction, from.hit.t);
                CHECK(glm::length(ray.ray.origin - start) < 1e-3F);
                if (ray.kind == PathRayKind::bounce) ++bounces;
                if (ray.kind != PathRayKind::shadow) continue;
                CHECK(ray.blocked == (ray.hit.hit != 0));
                ++(ray.blocked ? blocked : reached);
            }
        }
        CHECK(reached > 20);
        CHECK(blocked > 5);
        CHECK((bounces > 20) == (integrator != std::string_view("ao")));
    }
}

TEST_CASE("the sum of recorded samples is the pixel") {
    Studio studio("path");
    constexpr std::uint64_t place = 130;
    Film film({24, 16});
    REQUIRE(add_samples(*studio.light, {studio.camera, place, 1, 0, 16, 3}, studio.caster,
                        studio.arrays, film));
    Vec3 mean(0);
    for (std::uint32_t s = 0; s < 16; ++s) {
        PathRecorder recorder(studio.caster);
        mean += studio.sample(place, s, recorder).radiance / 16.0F;
    }
    Vec3 drawn(0);
    for (std::uint64_t pixel = 0; pixel < film.size().pixels(); ++pixel)
        drawn += Vec3(film.colour(pixel));
    CHECK(glm::length(mean - drawn) <= 1e-5F * glm::length(drawn));
    CHECK(glm::length(drawn) > 0);
}
