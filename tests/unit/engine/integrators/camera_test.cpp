#include "engine/integrators/camera.h"

#include "engine/integrators/generators.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

using namespace raynest;
using test::translation;

namespace {

SceneDescription with_cameras() {
    SceneDescription scene = test::tree_scene();
    scene.cameras = {{"front", translation(0, 0, 5), 0.5F, 1.5F},
                     {"side", translation(9, 0, 0), 0.6F, 0},
                     {"1", translation(7, 7, 7), 0.9F, 0}};
    return scene;
}

Ray ray_of(const Camera& camera, std::uint32_t width, std::uint32_t height, std::uint64_t pixel) {
    return pinhole(camera, {width, height}).ray(pixel % width, pixel / width);
}

bool is_close(const Vec3& a, const Vec3& b) {
    return glm::length(a - b) < 1e-5F;
}

}  // namespace

TEST_CASE("digits alone are the number of a camera, other texts are names, none is the first") {
    const auto scene = test::build_scene(with_cameras());
    CHECK(choose_camera(*scene, {})->name == "front");
    CHECK(choose_camera(*scene, {})->yfov == 0.5F);
    CHECK(choose_camera(*scene, {.name = "side"})->to_world.m[3] == 9);
    CHECK(choose_camera(*scene, {.name = "0"})->name == "front");
    CHECK(choose_camera(*scene, {.name = "1"})->to_world.m[3] == 9);  // not the one of that name
    const auto none = choose_camera(*scene, {.name = "back"});
    REQUIRE_FALSE(none.has_value());
    CHECK(none.error().code == ErrorCode::scene_invalid);
    CHECK(none.error().message.find("'side'") != std::string::npos);
    CHECK_FALSE(choose_camera(*scene, {.name = "3"}).has_value());
    SceneDescription twice = with_cameras();
    twice.cameras[1].name = "front";
    const auto several = choose_camera(*test::build_scene(twice), {.name = "front"});
    REQUIRE_FALSE(several.has_value());
    CHECK(several.error().message.find("several cameras are called 'front': give the number") == 0);
}

TEST_CASE("rays go through pixel centres, y down, one unit along the view axis") {
    Camera camera;
    camera.yfov = 2 * std::atan(1.0F);  // half height 1
    camera.to_world = translation(1, 2, 3);
    const Ray corner = ray_of(camera, 4, 2, 0);
    CHECK(is_close(corner.direction, {-1.5F, 0.5F, -1}));
    CHECK(corner.origin == Vec3(1, 2, 3));
    CHECK(corner.tmin == 0);
    CHECK(corner.tmax == std::numeric_limits<float>::infinity());
    CHECK(is_close(ray_of(camera, 4, 2, 3).direction, {1.5F, 0.5F, -1}));
    CHECK(is_close(ray_of(camera, 4, 2, 4).direction, {-1.5F, -0.5F, -1}));
    CHECK(is_close(ray_of(camera, 1, 1, 0).direction, {0, 0, -1}));
}

TEST_CASE("the tile order meets every pixel once, whole tiles first square by square") {
    for (const auto& [width, height] :
         {std::pair{1U, 1U}, {7U, 5U}, {16U, 8U}, {17U, 9U}, {9U, 64U}}) {
        std::vector<int> met(std::size_t{width} * height, 0);
        for (std::uint64_t place = 0; place < met.size(); ++place) {
            const std::uint64_t pixel = tile_order(place, width, height);
            REQUIRE(pixel < met.size());
            ++met[pixel];
        }
        CHECK(std::count(met.begin(), met.end(), 1) == static_cast<std::ptrdiff_t>(met.size()));
    }
    std::vector<std::uint64_t> pixels;
    for_each_in_tiles(3, 400, 37, 21, [&](std::uint64_t i, std::uint64_t x, std::uint64_t y) {
        CHECK(i == pixels.size());
        pixels.push_back(y * 37 + x);
    });
    REQUIRE(pixels.size() == 400);
    for (std::uint64_t i = 0; i < 400; ++i) CHECK(pixels[i] == tile_order(3 + i, 37, 21));
    for (std::uint64_t place = 0; place < 64; ++place) {
        const std::uint64_t pixel = tile_order(place, 17, 9);
        CHECK(pixel % 17 < 8);
        CHECK(pixel / 17 < 8);
        if (place < 16) CHECK(std::max(pixel % 17, pixel / 17) < 4);
    }
}

TEST_CASE("look-at sees its target in the middle, up on top") {
    const auto scene = test::build_scene(test::tree_scene());
    CameraRequest request;
    request.look_at = true;
    request.eye = {10, 0, 0};
    request.at = {0, 0, 0};
    const auto camera = choose_camera(*scene, request);
    REQUIRE(camera.has_value());
    CHECK(camera->yfov == doctest::Approx(40 * 3.14159265 / 180));
    CHECK(is_close(ray_of(*camera, 1, 1, 0).direction, {-1, 0, 0}));
    CHECK(ray_of(*camera, 3, 3, 1).direction.y > 0);
    CHECK(ray_of(*camera, 3, 3, 5).direction.z < 0);  // the right of a view along -x

    request.fov_degrees = 90;
    CHECK(choose_camera(*scene, request)->yfov == doctest::Approx(3.14159265 / 2));
}

TEST_CASE("a view direction along `up` still gives a camera") {
    const auto scene = test::build_scene(test::tree_scene());
    CameraRequest request;
    request.look_at = true;
    request.eye = {0, 10, 0};
    request.at = {0, 0, 0};
    const auto down = choose_camera(*scene, request);
    REQUIRE(down.has_value());
    CHECK(is_close(ray_of(*down, 1, 1, 0).direction, {0, -1, 0}));
    CHECK(ray_of(*down, 3, 3, 1).direction.z < 0);
    request.up = request.eye = {0, 0, 5};
    const auto map = choose_camera(*scene, request);
    CHECK(is_close(ray_of(*map, 1, 1, 0).direction, {0, 0, -1}));
    CHECK(ray_of(*map, 3, 3, 1).direction.y > 0);  // north on top, as on a map
}

TEST_CASE("cameras that are chosen have the scene's axis up") {
    SceneDescription description = test::tree_scene();
    description.up = UpAxis::z;
    const auto scene = test::build_scene(description);
    CHECK(scene->up() == UpAxis::z);
    const auto automatic = choose_camera(*scene, {});
    REQUIRE(automatic.has_value());
    CHECK(is_close(ray_of(*automatic, 1, 1, 0).direction, glm::normalize(Vec3(-1, 1, -1))));
    CHECK(ray_of(*automatic, 3, 3, 1).direction.z > ray_of(*automatic, 3, 3, 7).direction.z);
    CameraRequest request;
    request.look_at = true;
    request.eye = {10, 0, 0};
    CHECK(ray_of(*choose_camera(*scene, request), 3, 3, 1).direction.z > 0);
}

TEST_CASE("unusable requests are refused") {
    const auto scene = test::build_scene(test::tree_scene());
    CameraRequest request;
    request.look_at = true;
    const auto refused = [&](const CameraRequest& r) {
        const auto camera = choose_camera(*scene, r);
        return !camera && camera.error().code == ErrorCode::param_invalid;
    };
    CHECK(refused(request));  // eye == at
    request.at = {1, 0, 0};
    CHECK_FALSE(refused(request));
    request.up = Vec3(0);
    CHECK(refused(request));
    request.up.reset();
    request.eye.x = std::numeric_limits<float>::quiet_NaN();
    CHECK(refused(request));
    for (const float fov : {-1.0F, 180.0F, std::numeric_limits<float>::infinity()}) {
        CHECK(refused({.fov_degrees = fov}));
    }
}

TEST_CASE("without cameras the whole scene is in the picture, seen from +x +y +z") {
    const auto scene = test::build_scene(test::tree_scene());
    const auto camera = choose_camera(*scene, {});
    REQUIRE(camera.has_value());
    CHECK(camera->name == "automatic");
    const Vec3 backward(camera->to_world.m[2], camera->to_world.m[6], camera->to_world.m[10]);
    CHECK(is_close(backward, glm::normalize(Vec3(1))));

    Transform to_camera;
    REQUIRE(invert(camera->to_world, to_camera));
    const Box box = scene->bounds();
    const float edge = std::tan(camera->yfov / 2);
    float nearest_to_edge = 0;
    for (int corner = 0; corner < 8; ++corner) {
        const Vec3 p = to_camera.point({(corner & 1) != 0 ? box.upper.x : box.lower.x,
                                        (corner & 2) != 0 ? box.upper.y : box.lower.y,
                                        (corner & 4) != 0 ? box.upper.z : box.lower.z});
        CHECK(p.z < 0);
        const float aside = std::max(std::abs(p.x), std::abs(p.y)) / -p.z;
        CHECK(aside < edge);
        nearest_to_edge = std::max(nearest_to_edge, aside / edge);
    }
    CHECK(nearest_to_edge > 0.9F);  // the scene fills the picture
}

TEST_CASE("an empty scene still has a camera") {
    SceneDescription description;
    description.objects.resize(1);
    const auto scene = test::build_scene(description);
    const auto camera = choose_camera(*scene, {});
    REQUIRE(camera.has_value());
    for (const float element : camera->to_world.m) CHECK(std::isfinite(element));
}
