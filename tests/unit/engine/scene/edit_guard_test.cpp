// Limits of edits, and the memory that they ask for before they are made.
#include "engine/scene/edits/edit_guard.h"

#include "engine/scene/edits/batch.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/link.h"
#include "engine/scene/edits/linked_paths.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

namespace raynest {
namespace {

/// A triangle, placed by `levels` objects above each other with so many instances each.
std::shared_ptr<const Snapshot> tower(std::uint32_t levels, std::uint32_t instances) {
    SceneDescription scene;
    scene.materials.resize(2);
    scene.objects.resize(levels + 1);
    GeometryDescription square = test::unit_square();
    square.material = 0;
    scene.objects[0].geometries.push_back(std::move(square));
    for (std::uint32_t level = 1; level <= levels; ++level)
        for (std::uint32_t i = 0; i < instances; ++i) {
            InstanceDescription& instance = scene.objects[level].instances.emplace_back();
            instance.object = level - 1;
            instance.transform = test::translation(static_cast<float>(i), 0, 0);
        }
    scene.root = levels;
    return test::build_scene(scene);
}

TEST_CASE("changes of 10^15 placements are refused without a look at each") {
    const auto scene = tower(15, 10);
    SceneChanges uids;
    for (std::uint32_t i = 0; i < 10; ++i) uids.uids.push_back({i, 7});
    const auto edited = edit_scene(*scene, uids);
    REQUIRE_FALSE(edited.has_value());
    CHECK(edited.error().code == ErrorCode::limit_exceeded);
    EditBatch batch(*scene);
    const auto painted = batch.set_material(3, 1);
    REQUIRE_FALSE(painted.has_value());
    CHECK(painted.error().code == ErrorCode::limit_exceeded);
    CHECK(batch.set_material({3, {1, 2, 3, 4, 5, 6, 7, 8, 9, 0, 1}}, 1).has_value());
    CHECK(batch.size() == 1000);
}

TEST_CASE("a scene out of parts has a limited number of nodes") {
    SceneDescription base = test::tree_scene();
    base.path_nodes = {{0, "", no_id, 0}, {0, "a", 0, 10}};
    base.placed_nodes = {1};
    const auto scene = test::build_scene(base);
    const auto forest = tower(4, 15);  // 50,625 placements
    const auto linked = [&](std::size_t copies) {
        AddedScene added{forest, "f", {}, {}};
        added.to_scene.resize(copies);
        added.masks.resize(copies, ~0U);
        return link_scenes(*scene, {}, {&added, 1});
    };
    CHECK(linked(2).has_value());
    const auto refused = linked(path_nodes_max / 50'000);
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == ErrorCode::limit_exceeded);
    CHECK(refused.error().message.find("'f'") != std::string::npos);
}

TEST_CASE("an edit asks for all that it takes, and ends where that is not granted") {
    const auto scene = tower(2, 40);
    SceneChanges changes;
    for (std::uint32_t i = 0; i < 40; ++i) changes.uids.push_back({i, i});
    std::uint64_t asked = 0, most = ~0ULL;
    const EditGuard guard{[&](std::uint64_t bytes) {
                              asked += bytes;
                              return asked <= most;
                          },
                          {}};
    const auto edited = edit_scene(*scene, changes, nullptr, guard);
    REQUIRE(edited.has_value());
    CHECK((*edited)->bytes().size() > scene->bytes().size());
    CHECK((*edited)->bytes().size() <= scene->bytes().size() + asked);
    const std::uint64_t all = std::exchange(asked, 0);
    most = all - 1;
    CHECK(edit_scene(*scene, changes, nullptr, guard).error().code == ErrorCode::out_of_memory);
    const EditGuard nobody{{}, [] { return true; }};
    CHECK(edit_scene(*scene, changes, nullptr, nobody).error().code == ErrorCode::out_of_memory);

    // So does a batch, before it holds them.
    asked = 0;
    most = 4096 * 512;
    EditBatch batch(*scene, guard);
    CHECK(batch.expect(4096).has_value());
    CHECK(asked == most);
    CHECK_FALSE(batch.expect(4097).has_value());
}

}  // namespace
}  // namespace raynest
