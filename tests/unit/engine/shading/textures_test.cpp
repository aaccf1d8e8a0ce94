// Smaller copies of textures, and how they are looked up.
#include "engine/scene/texture_levels.h"
#include "engine/shading/texture_lookup.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>

using namespace raynest;

namespace {

ImageDescription checkers(std::uint32_t width, std::uint32_t height) {
    ImageDescription image{width, height,
                           std::vector<std::uint8_t>(std::size_t{4} * width * height, 255)};
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x)
            for (std::size_t c = 0; c < 3; ++c)
                image.rgba[4 * (std::size_t{y} * width + x) + c] = (x + y) % 2 == 0 ? 255 : 0;
    return image;
}

}  // namespace

TEST_CASE("levels halve each side down to one pixel") {
    CHECK(level_count(1, 1) == 1);
    CHECK(level_count(2, 1) == 2);
    CHECK(level_count(5, 3) == 3);
    CHECK(level_count(1024, 16) == 11);
    CHECK(smaller_levels(checkers(1, 1), false).empty());
    CHECK(smaller_levels(checkers(5, 3), false).size() == 4 * (2 * 1 + 1));
}

TEST_CASE("colours are averaged in linear light, data as they are") {
    const std::vector<std::uint8_t> colour = smaller_levels(checkers(4, 4), false);
    const std::vector<std::uint8_t> data = smaller_levels(checkers(4, 4), true);
    // Half of the light of white is sRGB 188.
    for (const std::size_t pixel : {0U, 3U, 4U}) {
        CHECK(std::abs(colour[4 * pixel] - 188) <= 1);
        CHECK(std::abs(data[4 * pixel] - 128) <= 1);
        CHECK(colour[4 * pixel + 3] == 255);
    }
    // A grey stays what it is, at any size.
    for (int grey = 0; grey < 256; ++grey) {
        ImageDescription image{2, 2,
                               std::vector<std::uint8_t>(16, static_cast<std::uint8_t>(grey))};
        for (std::size_t i = 3; i < 16; i += 4) image.rgba[i] = 255;
        CHECK(std::abs(smaller_levels(image, false)[0] - grey) <= 1);
        CHECK(smaller_levels(image, true)[0] == grey);
    }
}

TEST_CASE("what is invisible leaves no fringe") {
    // One green leaf pixel among three transparent black ones.
    ImageDescription image{2, 2, std::vector<std::uint8_t>(16, 0)};
    image.rgba[1] = 200;
    image.rgba[3] = 255;
    const std::vector<std::uint8_t> level = smaller_levels(image, false);
    CHECK(std::abs(level[1] - 200) <= 1);
    CHECK(level[3] == 64);
}

TEST_CASE("a wide cone sees the mean, a narrow one the texel") {
    SceneDescription scene = test::tree_scene();
    scene.images = {checkers(16, 16)};
    scene.textures.resize(2);
    scene.textures[0].image = scene.textures[1].image = 0;
    scene.textures[1].linear = true;
    scene.textures[1].alpha = false;
    const auto snapshot = test::build_scene(scene);
    const ShadingView& view = snapshot->shading();
    const auto at = [&](std::uint32_t texture, float width) {
        return sample_texture(view, texture, {0.5F / 16, 0.5F / 16}, {std::log2(width)},
                              texture == 1)
            .x;
    };
    for (const std::uint32_t texture : {0U, 1U}) {
        CHECK(at(texture, 1e-6F) == doctest::Approx(1));
        CHECK(at(texture, 0.5F) == doctest::Approx(0.5).epsilon(0.02));
        CHECK(at(texture, 100) == doctest::Approx(0.5).epsilon(0.02));
        // Between two levels: half of each.
        CHECK(at(texture, std::sqrt(2.0F) / 16) == doctest::Approx(0.75).epsilon(0.02));
    }
}
