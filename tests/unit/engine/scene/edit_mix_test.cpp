// Many edits of all kinds, one after the other, in one scene of built-in ones.
#include "engine/assets/builtin/builtin.h"
#include "engine/math/random.h"
#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/names.h"

#include <doctest/doctest.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

using Scene = std::shared_ptr<const Snapshot>;

Scene built(const char* source) {
    const auto description = describe_builtin(source);
    REQUIRE(description.has_value());
    const auto snapshot = Snapshot::build(*description);
    REQUIRE(snapshot.has_value());
    return *snapshot;
}

/// Checks that the scene is one that any reader would take, with the digest that it says, and that
/// each path is found by its text.
void check_whole(const Snapshot& scene) {
    BuiltArena copy{Arena(scene.bytes().size()), 0};
    std::ranges::copy(scene.bytes(), copy.arena.data());
    const auto opened = Snapshot::open(std::move(copy));
    REQUIRE_MESSAGE(opened, opened.error().message);
    CHECK((*opened)->digest() == scene.digest());
    for (std::uint64_t path = 0; path < scene.statistics().instances; path += 97) {
        const auto steps = expand_path(scene, path);
        REQUIRE(steps.has_value());
        const auto found = find_path(scene, path_name(*steps));
        REQUIRE_MESSAGE(found, path_name(*steps));
        CHECK(*found == path);
    }
}

}  // namespace

TEST_CASE("edits of all kinds follow each other, and every epoch is whole") {
    const Scene forest = built("builtin:forest?trees=20");
    const Scene flake = built("builtin:flake?depth=3");
    Scene scene = built("builtin:street?cars=20&length=100");
    Scene spare;
    Random random(3);
    for (int step = 0; step < 60; ++step) {
        CAPTURE(step);
        EditBatch batch(*scene);
        InstanceFinder finder(*scene, [] { return false; });
        const auto each = [&](const std::string& text, auto&& change) {
            const auto found = finder.find(text);
            if (found) std::ranges::for_each(*found, change);
        };
        const Matrix aside = translation_by({static_cast<double>(random.uniform(-10, 10)), 0, 1});
        each(fmt::format("car-{}", random.below(20)),
             [&](const InstancePlace& place) { batch.move(place, aside, EditFrame::own); });
        each(fmt::format("car-{}/wheel-*", random.below(20)), [&](const InstancePlace& place) {
            batch.move(place, aside, EditFrame::parent);
            if (step % 5 == 0) batch.set_mask(place, random.below(2) == 0 ? 0 : ~0U);
        });
        std::vector<Vec3> vertices;
        if (step % 7 == 3) {
            const InstancePlace tree = finder.find("tree-1")->front();
            const SceneView& view = scene->view();
            const std::uint32_t first = view.objects[view.root].first_instance;
            const ObjectRecord& object =
                view.objects[view.instances[first + tree.outermost].object];
            std::uint32_t count = 0;
            for (std::uint32_t g = 0; g < object.geometry_count; ++g)
                count += view.geometries[object.first_geometry + g].vertex_count;
            for (std::uint32_t i = 0; i < count; ++i)
                vertices.emplace_back(random.uniform(), random.uniform(), random.uniform());
            CHECK(batch.set_vertices(tree, {vertices}).has_value());
        }
        if (step % 10 == 4)
            for (int copy = 0; copy < 3; ++copy)
                batch.add(0, step % 20 == 4 ? forest : flake, step % 20 == 4 ? "wood" : "ball",
                          aside, ~0U);
        if (step % 20 == 19)
            each("wood#*",
                 [&](const InstancePlace& place) { CHECK(batch.remove(place).has_value()); });
        auto next = edit_scene(*scene, batch.changes(), std::move(spare));
        REQUIRE_MESSAGE(next, next.error().message);
        spare = std::exchange(scene, std::move(*next));
        check_whole(*scene);
    }
    // The woods have gone again, and what was theirs; three times three balls are there.
    InstanceFinder finder(*scene, [] { return false; });
    CHECK(!finder.find("wood*").has_value());
    CHECK(finder.find("ball#*")->size() == 9);
}
