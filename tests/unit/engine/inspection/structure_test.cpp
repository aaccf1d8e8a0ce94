// The facts of a scene's objects.
#include "engine/inspection/structure.h"

#include "engine/math/random.h"
#include "engine/scene/tree_overlap.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

using namespace raynest;

namespace {

/// 60 triangles that lie across each other, `turn` of them later in the list than they were.
GeometryDescription soup(std::size_t turn) {
    Random random(7);
    const auto within = [&](float size) {
        const float x = random.uniform(-size, size);
        const float y = random.uniform(-size, size);
        return Vec3(x, y, random.uniform(-size, size));
    };
    GeometryDescription soup;
    for (int i = 0; i < 60; ++i) {
        const Vec3 centre = within(1);
        for (int corner = 0; corner < 3; ++corner) {
            soup.indices.push_back(static_cast<std::uint32_t>(soup.positions.size()));
            soup.positions.push_back(centre + within(0.5F));
        }
    }
    std::ranges::rotate(soup.indices, soup.indices.begin() + static_cast<std::ptrdiff_t>(3 * turn));
    return soup;
}

}  // namespace

TEST_CASE("the bytes of an object count each attribute of its vertices") {
    const auto bytes_of = [](const GeometryDescription& square) {
        SceneDescription scene;
        scene.objects.resize(1);
        scene.objects[0].geometries = {square};
        return object_facts(*test::build_scene(scene), 0, 1).at(0).bytes;
    };
    const GeometryDescription plain = test::unit_square();
    GeometryDescription coloured = plain;
    coloured.colours.assign(4 * plain.positions.size(), 255);
    CHECK(bytes_of(coloured) == bytes_of(plain) + 4 * plain.positions.size());
}

TEST_CASE("trees overlap what they do not hold where instances share a place") {
    const auto overlap_of = [](float apart) {
        SceneDescription scene;
        scene.objects.resize(2);
        scene.objects[0].geometries = {test::unit_square()};
        scene.objects[1].instances = {test::place(0, Transform{}),
                                      test::place(0, test::translation(apart, 0, 0))};
        scene.root = 1;
        const auto facts = object_facts(*test::build_scene(scene), 0, 2);
        CHECK(facts.at(0).overlap == 0);
        return facts.at(1).overlap;
    };
    CHECK(overlap_of(3) == 0);
    const double whole = overlap_of(0);  // the other instance, and its one leaf
    CHECK(whole == doctest::Approx(4.6).epsilon(1e-6));
    const double half = overlap_of(0.5F);
    CHECK(half > 0.2 * whole);
    CHECK(half < 0.8 * whole);
}

TEST_CASE("the overlap of what has no area is said to be unknown") {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {test::unit_square()};
    for (Vec3& position : scene.objects[0].geometries[0].positions) position.y = 0;
    CHECK(std::isnan(object_facts(*test::build_scene(scene), 0, 1).at(0).overlap));
}

TEST_CASE("overlaps that are too many to be looked at are said to be unknown") {
    SceneDescription scene;
    scene.objects.resize(24);
    scene.objects[0].geometries = {test::unit_square()};
    for (std::uint32_t i = 1; i < 24; ++i)
        scene.objects[i].instances.assign(4, test::place(i - 1, Transform{}));
    scene.root = 23;
    const auto facts = object_facts(*test::build_scene(scene), 0, 24);
    CHECK(facts.at(1).overlap == doctest::Approx(3 * 4.6).epsilon(1e-6));
    CHECK(std::isnan(facts.at(23).overlap));
}

TEST_CASE("objects that are equal overlap equally, and alike in another order of their triangles") {
    constexpr std::uint32_t copies = 6;
    SceneDescription scene;
    scene.objects.resize(2 * copies + 1);
    ObjectDescription& root = scene.objects.back();
    for (std::uint32_t i = 0; i < 2 * copies; ++i) {
        scene.objects[i].geometries = {soup(i < copies ? 0 : 9 * (i - copies + 1))};
        root.instances.push_back(
            test::place(i, test::translation(4 * static_cast<float>(i), 0, 0)));
    }
    scene.root = 2 * copies;
    const auto facts = object_facts(*test::build_scene(scene), 0, 2 * copies + 1);
    const double overlap = facts.at(0).overlap;
    CHECK(overlap > 0);
    for (std::uint32_t i = 0; i < copies; ++i) CHECK(facts.at(i).overlap == overlap);
    for (std::uint32_t i = copies; i < 2 * copies; ++i)
        CHECK(facts.at(i).overlap == doctest::Approx(overlap).epsilon(0.08));
}

TEST_CASE("the overlap of a whole scene is that of its outermost object") {
    SceneDescription scene;
    scene.objects.resize(3);
    scene.objects[0].geometries = {soup(0)};
    scene.objects[1].geometries = {soup(20)};
    scene.objects[2].instances = {test::place(0, Transform{}),
                                  test::place(1, test::translation(0.5F, 0, 0))};
    scene.root = 2;
    const auto built = test::build_scene(scene);
    const double overlap = measure_overlap(built->view());
    CHECK(overlap > 0);
    CHECK(overlap == object_facts(*built, 2, 1).at(0).overlap);
}
