// Textures looked up in batches, against single lookups; and the elementary functions of shading.
#include "engine/shading/texture_batch.h"

#include "engine/math/elementary.h"
#include "engine/math/random.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

using namespace raynest;

TEST_CASE(
    "a batch gives the bits of single lookups, whatever textures, levels and wraps it mixes") {
    Random random(1);
    SceneDescription scene = test::tree_scene();
    for (const auto& [width, height] : {std::pair{64U, 32U}, {5U, 3U}, {1U, 1U}, {2U, 16U}}) {
        ImageDescription image{width, height,
                               std::vector<std::uint8_t>(std::size_t{4} * width * height)};
        for (std::uint8_t& byte : image.rgba) byte = static_cast<std::uint8_t>(random.below(256));
        scene.images.push_back(image);
    }
    for (std::uint32_t image = 0; image < 4; ++image) {
        for (const Wrap wrap : {Wrap::repeat, Wrap::clamp, Wrap::mirror}) {
            for (const bool nearest : {false, true}) {
                TextureDescription texture;
                texture.image = image;
                texture.wrap_s = wrap;
                texture.wrap_t = wrap == Wrap::clamp ? Wrap::repeat : wrap;
                texture.nearest = nearest;
                scene.textures.push_back(texture);
            }
        }
    }
    const auto snapshot = test::build_scene(scene);
    const ShadingView& view = snapshot->shading();
    const TextureTable table(view);
    TextureBatch batch(table);
    const float none = std::numeric_limits<float>::quiet_NaN();
    for (const std::size_t count : {1U, 5U, 16U, 333U}) {
        std::vector<Vec4> values(count, Vec4(9)), expected(count);
        for (std::size_t i = 0; i < count; ++i) {
            const std::uint32_t texture = random.below(snapshot->view().texture_count);
            Vec2 st(random.uniform(-3, 3), random.uniform(-3, 3));
            if (i % 7 == 1) st = {0, 1};
            if (i % 7 == 2) st = {none, -0.0F};
            const Footprint footprint{i % 5 == 0 ? -1e9F : random.uniform(-8, 3)};
            const bool data = random.below(2) == 0;
            batch.add(texture, st, footprint, data, &values[i]);
            expected[i] = sample_texture(view, texture, st, footprint, data);
        }
        batch.run();
        CHECK(std::memcmp(values.data(), expected.data(), count * sizeof(Vec4)) == 0);
    }
}

TEST_CASE("elementary functions are as close as they say") {
    constexpr int steps = 100000;
    double circle_error = 0, cosine_error = 0, tangent_error = 0, logarithm_error = 0;
    for (int i = 0; i <= steps; ++i) {
        const float u = static_cast<float>(i) / steps;
        const double angle = 2 * std::numbers::pi * static_cast<double>(u);
        const Vec2 c = circle(u);
        circle_error = std::max({circle_error, std::abs(static_cast<double>(c.x) - std::cos(angle)),
                                 std::abs(static_cast<double>(c.y) - std::sin(angle))});
        const float x = 2 * u - 1;
        cosine_error = std::max(cosine_error, std::abs(static_cast<double>(arc_cosine(x)) -
                                                       std::acos(static_cast<double>(x))));
        const double exact = std::atan2(static_cast<double>(c.y), static_cast<double>(c.x));
        tangent_error =
            std::max(tangent_error, std::abs(static_cast<double>(arc_tangent(c.y, c.x)) - exact));
        const float power = std::exp2(40 * x);
        logarithm_error =
            std::max(logarithm_error, std::abs(static_cast<double>(rough_log2(power)) -
                                               std::log2(static_cast<double>(power))));
    }
    CHECK(circle_error < 3e-7);
    CHECK(cosine_error < 5e-7);
    CHECK(tangent_error < 4e-7);
    CHECK(logarithm_error < 3e-5);
    CHECK(arc_tangent(0, 0) == 0);
    CHECK(arc_cosine(2) == 0);
}
