#include "engine/integrators/picture.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <vector>

using namespace raynest;

namespace {

/// One square viewed along -z, hit at texture coordinates (s, t) = (x, y).
struct Seen {
    std::shared_ptr<const Snapshot> scene;
    std::vector<Ray> rays{1};
    std::vector<HitRecord> hits{1};

    explicit Seen(const SceneDescription& description) : scene(test::build_scene(description)) {
        rays[0].direction = {0, 0, -3};
        hits[0].hit = 1;
        hits[0].t = 1;
        hits[0].path = 0;
        hits[0].object = 0;
        hits[0].triangle = 0;
    }
    Vec4 at(float x, float y) {  // in triangle 0: x >= y
        hits[0].u = x - y;
        hits[0].v = y;
        Vec4 out;
        shade_primary({&scene->view(), rays, hits}, {&out, 1});
        return out;
    }
};

SceneDescription textured(std::uint32_t width, std::uint32_t height,
                          std::vector<std::uint8_t> rgba) {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square(0)};
    scene.materials.resize(1);
    scene.materials[0].texture = 0;
    scene.textures = {{0, Wrap::clamp, Wrap::clamp, false}};
    scene.images = {{width, height, std::move(rgba)}};
    return scene;
}

bool is_close(const Vec4& a, const Vec4& b) {
    return glm::length(a - b) < 1e-4F;
}

}  // namespace

TEST_CASE("a miss is 0.18 grey and transparent") {
    SceneDescription scene = textured(1, 1, {255, 0, 0, 255});
    Seen seen(scene);
    seen.hits[0] = HitRecord{};
    CHECK(seen.at(0, 0) != Vec4(0));
    seen.hits[0].hit = 0;
    Vec4 out;
    shade_primary({&seen.scene->view(), seen.rays, seen.hits}, {&out, 1});
    CHECK(out == Vec4(0.18F, 0.18F, 0.18F, 0));
}

TEST_CASE("base colour is factor times decoded texture times vertex colour") {
    SceneDescription scene = textured(1, 1, {255, 188, 0, 9});
    scene.materials[0].base_colour = {0.5F, 1, 1, 0.3F};
    scene.objects[0].geometries[0].colours = {255, 255, 255, 255, 255, 124, 255, 255,
                                              255, 255, 255, 255, 255, 255, 255, 255};
    const float green = std::pow((188 / 255.0F + 0.055F) / 1.055F, 2.4F);
    const float vertex = std::pow((124 / 255.0F + 0.055F) / 1.055F, 2.4F);
    CHECK(is_close(Seen(scene).at(0, 0), {0.5F, green, 0, 1}));
    CHECK(is_close(Seen(scene).at(1, 0), {0.5F, vertex * green, 0, 1}));
}

TEST_CASE("a default material is white, and light falls off with the angle") {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square()};
    Seen seen(scene);
    CHECK(is_close(seen.at(0.5F, 0.2F), {1, 1, 1, 1}));
    seen.rays[0].direction = {0, 3, 3};  // from behind, 45 degrees
    const float slant = std::sqrt(0.5F);
    CHECK(is_close(seen.at(0.5F, 0.2F), {slant, slant, slant, 1}));
}

TEST_CASE("colour is filtered between texel centres, or nearest if the sampler requests it") {
    // Two texels side by side: black, white.
    SceneDescription scene = textured(2, 1, {0, 0, 0, 255, 255, 255, 255, 255});
    CHECK(Seen(scene).at(0.25F, 0).x == doctest::Approx(0));
    CHECK(Seen(scene).at(0.5F, 0).x == doctest::Approx(0.5F));
    CHECK(Seen(scene).at(0.625F, 0).x == doctest::Approx(0.75F));
    CHECK(Seen(scene).at(1, 0).x == doctest::Approx(1));
    scene.textures[0].wrap_s = Wrap::repeat;
    CHECK(Seen(scene).at(1, 0).x == doctest::Approx(0.5F));  // half way to the first again
    scene.textures[0].nearest = true;
    CHECK(Seen(scene).at(0.49F, 0).x == doctest::Approx(0));
    CHECK(Seen(scene).at(0.51F, 0).x == doctest::Approx(1));
}

TEST_CASE("row 0 is at t = 0 and the material's transform moves coordinates") {
    SceneDescription scene = textured(1, 2, {255, 255, 255, 255, 0, 0, 0, 255});
    CHECK(Seen(scene).at(1, 0.1F).x == doctest::Approx(1));
    CHECK(Seen(scene).at(1, 0.9F).x == doctest::Approx(0));
    scene.materials[0].uv_transform = {1, 0, 0, 0, -1, 1};  // t' = 1 - t
    CHECK(Seen(scene).at(1, 0.1F).x == doctest::Approx(0));
}

TEST_CASE("non-finite texture coordinates give a colour, not a crash") {
    SceneDescription scene = textured(2, 2, std::vector<std::uint8_t>(16, 255));
    for (Vec2& st : scene.objects[0].geometries[0].texcoords[0]) {
        st = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()};
    }
    for (const Wrap wrap : {Wrap::repeat, Wrap::clamp, Wrap::mirror}) {
        scene.textures[0].wrap_s = scene.textures[0].wrap_t = wrap;
        CHECK(is_close(Seen(scene).at(0.5F, 0.25F), {1, 1, 1, 1}));
    }
}

TEST_CASE("pictures are sRGB with linear alpha, and nothing overflows a byte") {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    const std::vector<Vec4> pixels{{0.18F, 0.5F, 1, 0.5F}, {7, -1, nan, 2}};
    const Picture picture = to_picture(2, 1, pixels);
    CHECK(picture.width == 2);
    CHECK(picture.rgba == std::vector<std::uint8_t>{118, 188, 255, 128, 255, 0, 0, 255});
}
