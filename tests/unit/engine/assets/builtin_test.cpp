#include "engine/assets/builtin/builtin.h"

#include "engine/scene/edits/pose.h"
#include "engine/scene/snapshot.h"

#include <doctest/doctest.h>

#include <cmath>

using namespace raynest;

namespace {

std::shared_ptr<const Snapshot> build_scene(const std::string& source) {
    const auto scene = describe_builtin(source);
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    auto snapshot = Snapshot::build(*scene);
    REQUIRE(snapshot.has_value());
    return *snapshot;
}

std::string refusal(const std::string& source) {
    const auto scene = describe_builtin(source);
    REQUIRE_FALSE(scene.has_value());
    return scene.error().message;
}

}  // namespace

TEST_CASE("the forest nests four levels, and is masked") {
    const auto forest = build_scene("builtin:forest");
    const SceneStatistics& s = forest->statistics();
    CHECK(s.levels == 4);
    CHECK(s.mask_materials >= 6);
    CHECK(s.cameras.size() == 2);
    CHECK(s.skipped.empty());
    CHECK(s.instanced_triangles > 1'000'000);
    CHECK(s.instanced_triangles < 20'000'000);
    CHECK(s.bytes < (64U << 20));
}

TEST_CASE("the same keys give the same forest, another seed another one") {
    const auto forest = build_scene("builtin:forest?trees=40&seed=7");
    CHECK(forest->digest() == build_scene("builtin:forest?seed=7&trees=40")->digest());
    CHECK(forest->digest() != build_scene("builtin:forest?trees=40&seed=8")->digest());
}

TEST_CASE("fewer levels hold the same triangles") {
    const auto nested = build_scene("builtin:forest?trees=40&leaves=4");
    for (const std::uint32_t levels : {1U, 2U, 3U}) {
        const auto flatter =
            build_scene("builtin:forest?trees=40&leaves=4&levels=" + std::to_string(levels));
        CHECK(flatter->statistics().levels == levels);
        CHECK(flatter->statistics().instanced_triangles ==
              nested->statistics().instanced_triangles);
        // A box of turned boxes is looser than a box of the same triangles, but not by much.
        const Vec3 slack = 0.05F * nested->bounds().size();
        for (int axis = 0; axis < 3; ++axis) {
            const Box& flat = flatter->bounds();
            const Box& loose = nested->bounds();
            CHECK(flat.lower[axis] >= loose.lower[axis] - 1e-3F);
            CHECK(flat.lower[axis] <= loose.lower[axis] + slack[axis]);
            CHECK(flat.upper[axis] <= loose.upper[axis] + 1e-3F);
            CHECK(flat.upper[axis] >= loose.upper[axis] - slack[axis]);
        }
    }
    CHECK(refusal("builtin:forest?trees=1000000&levels=1").find("more than") != std::string::npos);
}

TEST_CASE("a forest may have any number of trees") {
    const auto triangles = [](const char* source) {
        return build_scene(source)->statistics().instanced_triangles;
    };
    CHECK(triangles("builtin:forest?trees=1") > 10000);
    CHECK(triangles("builtin:forest?trees=100000") > 50 * triangles("builtin:forest?trees=1000"));
}

TEST_CASE("the street has cars with four wheels each, on four lanes that lead both ways") {
    const auto street = build_scene("builtin:street?cars=9&length=100");
    CHECK(street->statistics().levels == 3);
    const auto has = [&](const std::string& path) { return find_path(*street, path).has_value(); };
    CHECK(has("car-0"));
    CHECK(has("car-8/wheel-3"));
    CHECK(!has("car-9"));
    CHECK(!has("car-8/wheel-4"));
    CHECK(has("house-0"));
    CHECK(street->statistics().cameras == std::vector<std::string>{"driver", "roof"});
    CHECK(street->bounds().upper.x - street->bounds().lower.x < 130);
    CHECK(build_scene("builtin:street?cars=0")->statistics().instances + 5 * 50 ==
          build_scene("builtin:street")->statistics().instances);
}

TEST_CASE("wind sways the plants of the forest about their feet, and each tree by itself") {
    const auto still = build_scene("builtin:forest?trees=100");
    CHECK(animations_of(*still).empty());
    const auto forest = build_scene("builtin:forest?trees=100&wind=1&seconds=4");
    REQUIRE(animations_of(*forest).size() == 1);
    CHECK(animations_of(*forest)[0].seconds == 4);
    const auto at = [&](double seconds) {
        const auto posed = pose(*forest, {0, seconds});
        REQUIRE(posed);
        return *posed;
    };
    const auto first = at(0), middle = at(1.3), last = at(4);
    const SceneView& view = forest->view();
    const ObjectRecord& root = view.objects[view.root];
    std::uint32_t trees = 0;
    for (std::uint32_t i = root.first_instance; i < root.first_instance + root.instance_count;
         ++i) {
        const std::string name = view.names + view.instance_infos[i].name;
        CAPTURE(name);
        CHECK(name.find("stand") == std::string::npos);
        // A point ten metres above the foot, and the foot.
        const auto points = [&](const Snapshot& scene) {
            const Transform& to_parent = scene.view().instance_infos[i].to_parent;
            return std::pair(to_parent.point({0, 10, 0}), to_parent.point({0, 0, 0}));
        };
        const auto [top, foot] = points(*first);
        const auto [moved_top, moved_foot] = points(*middle);
        const auto [last_top, last_foot] = points(*last);
        CHECK(glm::distance(foot, moved_foot) < 1e-3F);
        CHECK(glm::distance(top, last_top) < 1e-3F);
        const float way = glm::distance(top, moved_top);
        const bool stands = name.starts_with("floor") || name.starts_with("boulder");
        CHECK((stands ? way == 0 : way > 0));
        CHECK(way < 0.9F);
        CHECK(std::abs(moved_top.z - top.z) < 1e-2F);
        trees += name.starts_with("leaves") || name.starts_with("thicket") || stands ? 0U : 1U;
    }
    CHECK(trees == 100);
    CHECK(refusal("builtin:forest?wind=1&levels=1").find("2 to 4 levels") != std::string::npos);
    CHECK(refusal("builtin:forest?wind=1&trees=20001").find("20000") != std::string::npos);
}

TEST_CASE("the terrain is one mesh, the flake is nested spheres") {
    const auto terrain = build_scene("builtin:terrain?size=64");
    CHECK(terrain->statistics().unique_triangles == 2 * 64 * 64);
    CHECK(terrain->statistics().levels == 1);
    const auto flake = build_scene("builtin:flake?depth=4");
    CHECK(flake->statistics().levels == 4);
    CHECK(flake->statistics().instances == 1 + 9 + 81 + 729);
    // At most 1 + 2/3 + 2/9 + 2/27 along one axis, and some slack for boxes of turned boxes.
    CHECK(flake->bounds().upper.y < 2.3F);
    CHECK(flake->bounds().upper.y > 1.6F);
}

TEST_CASE("an unknown scene or key is an error that lists the known ones") {
    for (const char* scene : {"forest", "terrain", "flake", "street"})
        CHECK(refusal("builtin:jungle").find(scene) != std::string::npos);
    CHECK(refusal("builtin:forest?tree=3").find("trees (1..4000000, default 1000)") !=
          std::string::npos);
    for (const char* source :
         {"builtin:forest?trees=0", "builtin:forest?trees=-1", "builtin:forest?trees=1e3",
          "builtin:forest?trees=99999999999999999999", "builtin:forest?trees",
          "builtin:flake?depth=17", "builtin:forest?&", "builtin:"}) {
        CAPTURE(source);
        CHECK_FALSE(describe_builtin(source).has_value());
    }
}
