// An edit looks at what changes and at what lies above it, not at what stands beside it; and its scene
// is that of a fresh build.
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/names.h"
#include "engine/scene/edits/uid_finder.h"
#include "engine/scene/named_paths.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;
using test::build_scene;
using test::place;
using test::translation;

namespace {

using Scene = std::shared_ptr<const Snapshot>;

/// Nodes that an edit may look at in trees of some thousand instances: the ways up, and beside each node
/// of them its eight children, for each side of the box.
constexpr std::uint64_t nodes_max = 600;

void check_as_fresh(const Snapshot& edited, const SceneDescription& description) {
    const Scene fresh = build_scene(description);
    CHECK(edited.bounds().lower == fresh->bounds().lower);
    CHECK(edited.bounds().upper == fresh->bounds().upper);
    CHECK(edited.digest() == fresh->digest());
    CHECK(edited.statistics().trees.sah_cost ==
          doctest::Approx(measure_trees(edited.view()).sah_cost).epsilon(1e-9));
}

/// Places squares in a row of rows, which end at the heights that height() says.
template <class Height>
std::vector<InstanceDescription> field(std::uint32_t side, Height&& height) {
    std::vector<InstanceDescription> parts;
    for (std::uint32_t i = 0; i < side * side; ++i)
        parts.push_back(place(0, translation(2 * static_cast<float>(i % side),
                                             2 * static_cast<float>(i / side), height())));
    return parts;
}

/// Moves parts of a field, those in its corners too; `to_place` says where they stand in the scene.
template <class ToPlace>
void move_parts(const SceneDescription& description, std::vector<InstanceDescription>& parts,
                Scene scene, Random& random, ToPlace&& to_place) {
    const auto count = static_cast<std::uint32_t>(parts.size());
    Scene spare;
    for (int step = 0; step < 30; ++step) {
        CAPTURE(step);
        const std::uint32_t which[] = {random.below(count), count - 1, 0, count - 60};
        const std::uint32_t part = which[step % 4];
        parts[part].transform.m[3] += 0.01F;
        // Now and then one stands out, and leaves again.
        parts[part].transform.m[11] += step % 8 == 3 ? 1e-5F : step % 8 == 7 ? -1e-5F : 0;
        const auto edited =
            edit_scene(*scene, {{{to_place(part), parts[part].transform}}}, std::move(spare));
        REQUIRE_MESSAGE(edited, edited.error().message);
        spare = std::exchange(scene, *edited);
        // The first ones look at everything, once for each side of the box.
        if (step >= 4) CHECK(scene->statistics().edits.nodes <= nodes_max);
        if (step % 3 == 0) check_as_fresh(*scene, description);
    }
}

}  // namespace

TEST_CASE("a part of a flat field moves without a look at the others") {
    for (const bool is_level : {true, false}) {
        CAPTURE(is_level);
        Random random(7);
        SceneDescription description;
        description.objects.resize(2);
        description.objects[0].geometries.push_back(test::unit_square());
        description.objects[1].instances =
            field(80, [&] { return is_level ? 0.1F : 0.1F + 1e-6F * random.unit(); });
        description.root = 1;
        move_parts(description, description.objects[1].instances, build_scene(description), random,
                   [](std::uint32_t part) { return InstancePlace(part); });
    }
}

TEST_CASE("a part of a group moves without a look at the others") {
    for (const bool is_shared : {false, true}) {
        CAPTURE(is_shared);
        Random random(8);
        SceneDescription description;
        description.objects.resize(4);
        description.objects[0].geometries.push_back(test::unit_square());
        description.objects[1].instances = field(80, [&] { return random.between(0, 1); });
        description.objects[2].instances = description.objects[1].instances;
        auto& root = description.objects[3].instances;
        root.push_back(place(1, translation(0.3F, 0, 0)));
        if (is_shared) root.push_back(place(2, translation(500, 0, 0)));
        const auto beside = field(70, [] { return 9.0F; });
        root.insert(root.end(), beside.begin(), beside.end());
        description.root = 3;
        // The first edit gives the two places objects of their own.
        SceneDescription before = description;
        if (is_shared) before.objects[3].instances[1].object = 1;
        move_parts(description, description.objects[1].instances, build_scene(before), random,
                   [](std::uint32_t part) { return InstancePlace(0, {part}); });
    }
}

TEST_CASE("the box of a flat field ends where its parts do, however many they are") {
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].geometries.push_back(test::unit_square());
    description.objects[1].instances = field(270, [] { return 0.1F; });
    description.root = 1;
    const Box box = build_scene(description)->bounds();
    CHECK(box.lower == Vec3(0, 0, 0.1F));
    CHECK(box.upper == Vec3(539, 539, 0.1F));
}

TEST_CASE("a text finds its part without a look at the others, in all epochs") {
    Random random(9);
    SceneDescription description;
    description.objects.resize(3);
    description.objects[0].geometries.push_back(test::unit_square());
    for (std::uint32_t i = 0; i < 900; ++i) {
        const std::uint32_t kind = random.below(4);
        const std::string name = kind == 0   ? ""
                                 : kind == 1 ? fmt::format("lone-{}", i)
                                             : std::string(kind == 2 ? "car" : "tree");
        const auto x = static_cast<float>(i);
        for (const std::uint32_t object : {1U, 2U})
            description.objects[object].instances.push_back(place(0, translation(x, 0, 0), name));
    }
    description.objects[2].instances.push_back(place(1, translation(0, 9, 0), "group"));
    description.root = 2;
    Scene scene = build_scene(description);
    CHECK(scene->steps().made() == 0);
    for (int epoch = 0; epoch < 3; ++epoch) {
        for (std::uint64_t path = 0; path < 1800; path += epoch == 0 ? 1 : 77) {
            const std::string text = path_name(*expand_path(*scene, path));
            CAPTURE(text);
            const auto found = find_path(*scene, text);
            REQUIRE_MESSAGE(found, found.error().message);
            CHECK(*found == path);
        }
        for (const char* text : {"car", "car#9999", "group#0", "lone-1#0", "group/car", "other"})
            CHECK(!find_path(*scene, text));
        scene = *edit_scene(*scene, {{{0, translation(0, 0, static_cast<float>(epoch))}}});
        // Those of the root and of the group, which epochs have in common.
        CHECK(scene->steps().made() == 2);
    }
}

TEST_CASE("user ids find their instances, in lists of runs, of equal ids and of both") {
    for (std::uint64_t seed = 0; seed < 12; ++seed) {
        CAPTURE(seed);
        Random random(seed);
        SceneDescription description;
        description.objects.resize(3);
        description.objects[0].geometries.push_back(test::unit_square());
        const auto list = [&](std::uint32_t count, std::uint32_t kinds) {
            std::vector<InstanceDescription> places;
            for (std::uint32_t i = 0; i < count; ++i) {
                const std::uint32_t uid = seed % 3 == 0   ? i / 2
                                          : seed % 3 == 1 ? i % 40
                                                          : random.below(60);
                places.push_back(
                    place(random.below(kinds), translation(static_cast<float>(i), 0, 0), "", uid));
            }
            return places;
        };
        description.objects[1].instances = list(80, 1);
        description.objects[2].instances = list(300, seed < 6 ? 1 : 2);
        description.root = 2;
        Scene scene = build_scene(description);
        for (int epoch = 0; epoch < 3; ++epoch) {
            const std::vector<std::uint32_t> wanted{0, 7, 39, 59, 149, 150};
            const auto found = find_uids(*scene, wanted, [] { return false; });
            REQUIRE(found);
            const auto& outer = description.objects[2].instances;
            for (std::size_t w = 0; w < wanted.size(); ++w) {
                std::vector<InstancePlace> expected;
                for (std::uint32_t i = 0; i < outer.size(); ++i) {
                    if (outer[i].uid == wanted[w]) {
                        expected.emplace_back(i);
                    } else if (outer[i].object == 1) {
                        const auto& inner = description.objects[1].instances;
                        for (std::uint32_t k = 0; k < inner.size(); ++k)
                            if (inner[k].uid == wanted[w]) expected.emplace_back(i, std::vector{k});
                    }
                }
                CHECK((*found)[w] == expected);
            }
            // An outermost mesh takes another id; the next epoch finds it by that one.
            for (std::uint32_t i = 10; i < 20; ++i) {
                if (outer[i].object != 0) continue;
                description.objects[2].instances[i].uid = 150;
                SceneChanges changes;
                changes.uids = {{i, 150}};
                scene = *edit_scene(*scene, changes);
                break;
            }
        }
    }
}

TEST_CASE("each of 600 meshes is deformed, and the digest is that of a fresh scene") {
    SceneDescription description;
    description.objects.resize(601);
    description.root = 600;
    for (std::uint32_t i = 0; i < 600; ++i) {
        description.objects[i].geometries.push_back(test::unit_square());
        const auto x = static_cast<float>(i);
        description.objects[i].geometries[0].positions[0].z = -x;
        description.objects[600].instances.push_back(place(i, translation(2 * x, 0, 0)));
    }
    Scene scene = build_scene(description);
    for (std::uint32_t i = 0; i < 600; ++i) {
        auto& positions = description.objects[i].geometries[0].positions;
        positions[1].z = 0.25F;
        SceneChanges changes;
        changes.deformed = {{i, {positions}}};
        scene = *edit_scene(*scene, changes);
        if (i % 100 == 99) CHECK(scene->digest() == build_scene(description)->digest());
    }
}

TEST_CASE("one of 300,000 parts moves, and the digest is that of a fresh scene") {
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].geometries.push_back(test::unit_square());
    auto& parts = description.objects[1].instances = field(548, [] { return 0.1F; });
    description.root = 1;
    Scene scene = build_scene(description);
    for (const std::size_t part : {std::size_t{0}, std::size_t{262'145}, parts.size() - 1}) {
        CAPTURE(part);
        const std::string before = scene->digest();
        parts[part].transform.m[11] = -1;
        const auto which = static_cast<std::uint32_t>(part);
        scene = *edit_scene(*scene, {{{which, parts[part].transform}}});
        CHECK(scene->digest() != before);
    }
    CHECK(scene->digest() == build_scene(description)->digest());
}
