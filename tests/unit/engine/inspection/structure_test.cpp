// The facts of a scene's objects.
#include "engine/inspection/structure.h"

#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cmath>
#include <cstdint>

using namespace raynest;

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
