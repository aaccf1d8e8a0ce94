#include "engine/geometry/path.h"

#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <set>
#include <string>

using namespace raynest;

TEST_CASE("path ids are dense and each names another leaf") {
    const auto scene = test::build_scene(test::tree_scene());
    std::set<std::string> names;
    for (std::uint64_t path = 0; path < 10; ++path) {
        const auto steps = expand_path(*scene, path);
        REQUIRE(steps.has_value());
        names.insert(path_name(*steps));
    }
    const std::set<std::string> expected{"first",      "first/low",   "first/leaf", "second",
                                         "second/low", "second/leaf", "lone",       "third",
                                         "third/low",  "third/leaf"};
    CHECK(names == expected);
}

TEST_CASE("an expanded path gives index and user id of each level") {
    const auto scene = test::build_scene(test::tree_scene());
    const auto steps = expand_path(*scene, 5);  // second twig, second leaf
    REQUIRE(steps.has_value());
    REQUIRE(steps->size() == 2);
    CHECK((*steps)[0].instance == 1);
    CHECK((*steps)[0].uid == 2);
    CHECK((*steps)[1].instance == 1);
    CHECK((*steps)[1].uid == 12);
    CHECK((*steps)[1].node == no_id);
}

TEST_CASE("nameless instances of nameless objects are named by their index") {
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].instances = {test::place(1, Transform{}), test::place(1, Transform{})};
    description.objects[1].geometries = {test::unit_square()};
    const auto scene = test::build_scene(description);
    CHECK(path_name(*expand_path(*scene, 1)) == "#1");
}

TEST_CASE("instances of empty groups take no path") {
    SceneDescription description;
    description.objects.resize(3);
    description.objects[0].instances = {test::place(2, Transform{}), test::place(1, Transform{}),
                                        test::place(2, Transform{}), test::place(1, Transform{}),
                                        test::place(2, Transform{})};
    description.objects[1].geometries = {test::unit_square()};
    const auto scene = test::build_scene(description);
    CHECK(scene->statistics().instances == 2);
    CHECK(expand_path(*scene, 0)->at(0).instance == 1);
    CHECK(expand_path(*scene, 1)->at(0).instance == 3);
}

TEST_CASE("the root's own primitives have an empty path; beyond the last there is none") {
    SceneDescription description;
    description.objects.resize(1);
    description.objects[0].geometries = {test::unit_square()};
    const auto scene = test::build_scene(description);
    const auto own = expand_path(*scene, 0);
    REQUIRE(own.has_value());
    CHECK(own->empty());
    const auto beyond = expand_path(*scene, 1);
    REQUIRE_FALSE(beyond.has_value());
    CHECK(beyond.error().code == ErrorCode::scene_invalid);
    CHECK_FALSE(expand_path(*scene, no_path).has_value());
}
