// Epochs that somebody holds share the memory that no edit has changed.
#include "engine/scene/edits/edit.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;

namespace {

using Scene = std::shared_ptr<const Snapshot>;

/// Squares in a row, in 4 MiB.
Scene squares() {
    SceneDescription scene;
    scene.objects.resize(2);
    scene.objects[0].geometries.push_back(test::unit_square());
    for (int i = 0; i < 20'000; ++i)
        scene.objects[1].instances.push_back(
            test::place(0, test::translation(static_cast<float>(2 * i), 0, 0)));
    scene.root = 1;
    const Scene built = test::build_scene(scene);
    REQUIRE(built->bytes().size() > (3U << 20));
    return built;
}

/// Lifts one outermost instance, or all of them.
Scene lifted(const Snapshot& scene, std::uint32_t first, std::uint32_t count, Scene spare) {
    const SceneView& view = scene.view();
    SceneChanges changes;
    for (std::uint32_t i = first; i < first + count; ++i) {
        Transform to = view.instance_infos[view.objects[view.root].first_instance + i].to_parent;
        to.m[7] += 0.25F;
        changes.moves.push_back({i, to});
    }
    auto edited = edit_scene(scene, changes, std::move(spare));
    REQUIRE_MESSAGE(edited, edited.error().message);
    return *edited;
}

std::uint32_t outermost_count(const Snapshot& scene) {
    return scene.view().objects[scene.view().root].instance_count;
}

/// The content that its bytes have.
std::string digest_of_bytes(const Snapshot& scene) {
    const auto opened = Snapshot::open({scene.copy_arena(), 0});
    REQUIRE(opened.has_value());
    return (*opened)->digest();
}

/// Memory of this process; what is mapped several times counts once.
std::size_t resident_bytes() {
    std::ifstream status("/proc/self/smaps_rollup");
    for (std::string line; std::getline(status, line);) {
        unsigned long long kib = 0;
        if (std::sscanf(line.c_str(), "Pss: %llu kB", &kib) == 1) return kib << 10;
    }
    return 0;
}

}  // namespace

TEST_CASE("epochs that are held take the memory of what has changed") {
    std::vector<Scene> epochs{squares()};
    const std::size_t whole = epochs[0]->bytes().size();
    const std::size_t before = resident_bytes();
    constexpr std::uint32_t count = 200;
    for (std::uint32_t i = 0; i < count; ++i)
        epochs.push_back(lifted(*epochs.back(), i % outermost_count(*epochs[0]), 1, nullptr));
    CHECK(epochs[0]->shared() == nullptr);
    CHECK(epochs[1]->own_bytes() == whole);  // the memory that the next one might take
    for (std::uint32_t i = 2; i <= count; ++i) {
        CAPTURE(i);
        CHECK(epochs[i]->shared() == epochs[2]->shared());
        CHECK(epochs[i]->own_bytes() < (whole / 4) + (256U << 10));
    }
    // The changes since the first shared epoch lie in the same pages mostly.
    CHECK(epochs[count]->own_bytes() < whole / 2);
    // The system may take pages of others back meanwhile.
    CHECK(resident_bytes() < before + count * (whole / 4));
    for (std::uint32_t i = 0; i <= count; i += 20) {
        CAPTURE(i);
        CHECK(digest_of_bytes(*epochs[i]) == epochs[i]->digest());
        CHECK((i == 0 || epochs[i]->digest() != epochs[i - 1]->digest()));
    }

    SUBCASE("and once nobody holds them, edits return to two whole arenas") {
        Scene scene = epochs.back();
        epochs.clear();
        Scene spare;
        for (int i = 0; i < 120; ++i) {
            Scene next = lifted(*scene, 5, 1, std::move(spare));
            spare = std::exchange(scene, std::move(next));
        }
        CHECK(scene->shared() == nullptr);
        CHECK(scene->own_bytes() == scene->bytes().size());  // a tree was built again
        CHECK(digest_of_bytes(*scene) == scene->digest());
        CHECK(digest_of_bytes(*spare) == spare->digest());
    }
    SUBCASE("and what goes on from one of them changes no other") {
        const std::string digest = epochs[100]->digest();
        Scene spare = std::move(epochs[100]), scene = lifted(*spare, 3, 1, nullptr);
        for (std::uint32_t i = 0; i < 10; ++i) {
            Scene next = lifted(*scene, i, 1, std::move(spare));
            spare = std::exchange(scene, std::move(next));
            CHECK(digest_of_bytes(*scene) == scene->digest());
        }
        CHECK(scene->digest() != digest);
        for (const std::uint32_t i : {99U, 101U, count})
            CHECK(digest_of_bytes(*epochs[i]) == epochs[i]->digest());
    }
}

TEST_CASE("epochs in which most has changed are whole arenas") {
    std::vector<Scene> epochs{squares()};
    for (int i = 0; i < 5; ++i)
        epochs.push_back(lifted(*epochs.back(), 0, outermost_count(*epochs[0]), nullptr));
    for (const Scene& epoch : epochs) {
        CHECK(epoch->own_bytes() == epoch->bytes().size());
        CHECK(digest_of_bytes(*epoch) == epoch->digest());
    }
}
