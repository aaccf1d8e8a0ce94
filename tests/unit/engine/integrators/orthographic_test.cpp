#include "engine/integrators/camera.h"
#include "engine/integrators/generators.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

using namespace raynest;
using test::translation;

namespace {

/// Returns a scene with a camera at (1, 2, 3) that shows 8 x 4 metres.
std::shared_ptr<const Snapshot> scene_with_camera() {
    SceneDescription scene = test::tree_scene();
    scene.cameras = {{"flat", translation(1, 2, 3), 0, 2, 2}};
    return test::build_scene(std::move(scene));
}

Ray ray_of(ImageSize size, std::uint64_t column, std::uint64_t row) {
    const auto scene = scene_with_camera();
    const auto camera = choose_camera(*scene, {});
    REQUIRE(camera.has_value());
    const Sensor sensor = camera_sensor(*camera, {{}, 0.5F, 9}, size);
    REQUIRE(std::holds_alternative<Orthographic>(sensor));
    return std::get<Orthographic>(sensor).ray(column, row);
}

}  // namespace

TEST_CASE("an orthographic camera has parallel rays over xmag and ymag") {
    const Ray first = ray_of({8, 4}, 0, 0);
    CHECK(first.origin == Vec3(1 - 3.5F, 2 + 1.5F, 3));
    CHECK(first.direction == Vec3(0, 0, -1));
    CHECK(first.tmin == 0.5F);
    CHECK(first.tmax == 9);
    CHECK(ray_of({8, 4}, 7, 3).origin == Vec3(1 + 3.5F, 2 - 1.5F, 3));
}

TEST_CASE("pixels are square, and all of xmag and ymag is in the picture") {
    CHECK(ray_of({16, 4}, 15, 0).origin == Vec3(1 + 7.5F, 2 + 1.5F, 3));
    CHECK(ray_of({8, 8}, 7, 0).origin == Vec3(1 + 3.5F, 2 + 3.5F, 3));
}

TEST_CASE("an orthographic camera has no field of view") {
    const auto scene = scene_with_camera();
    const auto refused = choose_camera(*scene, {.fov_degrees = 40});
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == ErrorCode::param_invalid);
    CHECK(refused.error().message.find("'flat' is orthographic") != std::string::npos);
}

TEST_CASE("a camera is either perspective or orthographic") {
    const float huge = std::numeric_limits<float>::infinity();
    for (const auto& [yfov, ymag] :
         {std::pair{0.0F, 0.0F}, {0.5F, 1.0F}, {0.0F, -1.0F}, {0.0F, huge}, {3.2F, 0.0F}}) {
        SceneDescription scene = test::tree_scene();
        scene.cameras = {{"odd", translation(0, 0, 0), yfov, 0, ymag}};
        CHECK_FALSE(Snapshot::build(scene).has_value());
    }
}
