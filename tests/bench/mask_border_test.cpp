// Tests which mismatches count as rounding: those within the border of a texel.
#include "tests/bench/mask_border.h"

#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <memory>

using namespace raynest;

namespace {

/// The square at z = 0 under a picture of 4 x 4 texels, each a quarter wide: the left half is
/// solid.
std::shared_ptr<const Snapshot> half_masked(AlphaMode mode, float x_offset) {
    SceneDescription scene;
    ImageDescription image{4, 4, {}};
    for (int texel = 0; texel < 16; ++texel) {
        const std::uint8_t alpha = texel % 4 < 2 ? 255 : 0;
        image.rgba.insert(image.rgba.end(), {0, 0, 0, alpha});
    }
    scene.images.push_back(image);
    scene.textures.push_back({0, Wrap::repeat, Wrap::repeat, true});
    scene.materials.resize(1);
    scene.materials[0].texture = 0;
    scene.materials[0].alpha_mode = mode;
    scene.objects.resize(2);
    scene.objects[0].geometries = {test::unit_square(0)};
    scene.objects[1].instances = {test::place(0, test::translation(x_offset, 0, 0))};
    scene.root = 1;
    return test::build_scene(scene);
}

/// Tests a ray that hits the square's first triangle at (x, y), where x > y.
bool at_border(float x, float y, AlphaMode mode = AlphaMode::mask, float x_offset = 0) {
    const auto scene = half_masked(mode, x_offset);
    HitRecord hit;
    hit.hit = 1;
    hit.path = 0;
    hit.triangle = 0;
    hit.object = scene->view().instances[0].object;
    return bench::is_at_mask_border(scene->view(), {Vec3(x + x_offset, y, 1), 0, Vec3(0, 0, -1)},
                                    hit);
}

}  // namespace

TEST_CASE("the border between a solid texel and a hole is decided by rounding, two ulp wide") {
    constexpr float ulp = 0x1p-23F;  // the largest coordinate is 1
    CHECK(at_border(0.5F, 0.2F));
    CHECK(at_border(0.5F + ulp, 0.2F));
    CHECK(at_border(0.5F - ulp, 0.2F));
    CHECK_FALSE(at_border(0.5F + 4 * ulp, 0.2F));
    CHECK_FALSE(at_border(0.5F - 4 * ulp, 0.2F));
}

TEST_CASE("the border is found where an instance places it") {
    CHECK(at_border(0.5F, 0.2F, AlphaMode::mask, 8));
    CHECK_FALSE(at_border(0.5F + 0x1p-18F, 0.2F, AlphaMode::mask, 8));
}

TEST_CASE("nothing else is excused") {
    CHECK_FALSE(at_border(0.3F, 0.2F));                     // inside a solid texel
    CHECK_FALSE(at_border(0.6F, 0.2F));                     // inside a hole
    CHECK_FALSE(at_border(0.25F, 0.2F));                    // between two solid texels
    CHECK_FALSE(at_border(0, 0.2F));                        // an edge, where the picture repeats
    CHECK_FALSE(at_border(0.5F, 0.2F, AlphaMode::opaque));  // no mask
}
