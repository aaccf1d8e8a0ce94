// Trees that edits have made slow are built again, wherever they stand.
#include "engine/scene/edits/edit.h"
#include "engine/scene/tree_statistics.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;
using test::build_scene;
using test::place;
using test::translation;

namespace {

using Scene = std::shared_ptr<const Snapshot>;
constexpr std::uint32_t part_count = 2000;

Transform somewhere(Random& random, float far = 100) {
    const Vec3 at = random.in_box(far);
    return translation(at.x, at.y, at.z);
}

/// Objects: a square, `part_count` of them in a group, a root of two groups. Or the root places the squares.
SceneDescription field(Random& random, bool in_group) {
    SceneDescription scene;
    scene.objects.resize(in_group ? 3 : 2);
    scene.objects[0].geometries = {test::unit_square()};
    for (std::uint32_t i = 0; i < part_count; ++i)
        scene.objects[1].instances.push_back(place(0, somewhere(random), "part"));
    if (in_group)
        for (const float x : {0.0F, 300.0F})
            scene.objects[2].instances.push_back(place(1, translation(x, 0, 0), "group"));
    scene.root = static_cast<std::uint32_t>(scene.objects.size()) - 1;
    return scene;
}

Scene edited_by(const Snapshot& scene, const SceneChanges& changes, Scene spare = nullptr) {
    auto edited = edit_scene(scene, changes, std::move(spare));
    REQUIRE_MESSAGE(edited, edited.error().message);
    return *edited;
}

/// Moves one part in a hundred, of the root or of its first group.
SceneChanges scatter(Random& random, std::vector<InstanceDescription>& parts, bool in_group) {
    SceneChanges changes;
    for (std::uint32_t i = random.below(100); i < part_count; i += 100) {
        parts[i].transform = somewhere(random);
        const InstancePlace place = in_group ? InstancePlace{0, {i}} : InstancePlace{i};
        changes.moves.push_back({place, parts[i].transform});
    }
    return changes;
}

double cost_of(const Snapshot& scene, std::uint32_t object) {
    return measure_each_tree(scene.view())[object].sah_cost;
}

/// Returns the object of the first outermost instance, or the root if `in_group` is false.
std::uint32_t object_of_parts(const Snapshot& scene, bool in_group) {
    const SceneView& view = scene.view();
    return in_group ? view.instances[view.objects[view.root].first_instance].object : view.root;
}

}  // namespace

TEST_CASE("a tree whose parts scatter stays as good as a new one, in the root and in a group") {
    for (const bool in_group : {false, true}) {
        CAPTURE(in_group);
        Random random(3);
        SceneDescription description = field(random, in_group);
        Scene scene = build_scene(description), spare;
        if (in_group) {  // the second group keeps its parts
            description.objects.push_back(description.objects[1]);
            description.objects[2].instances[0].object = 3;
            std::swap(description.objects[2], description.objects[3]);
            description.objects[3].instances[0].object = 2;
            description.root = 3;
        }
        auto& parts = description.objects[in_group ? 2 : 1].instances;
        for (int step = 0; step < 60; ++step) {
            if (step == 20) {  // what is added leaves the knowledge of other trees
                AddedScene added;
                added.scene = test::square(1);
                added.name = "more";
                added.to_scene = {translation(0, 0, 900)};
                added.masks = {~0U};
                SceneChanges changes;
                changes.added = {added};
                if (in_group) scene = edited_by(*scene, changes);
            }
            Scene next = edited_by(*scene, scatter(random, parts, in_group), std::move(spare));
            spare = std::exchange(scene, std::move(next));
        }
        const Scene fresh = build_scene(description);
        CHECK(cost_of(*scene, object_of_parts(*scene, in_group)) <
              1.3 * cost_of(*fresh, object_of_parts(*fresh, in_group)));
        CHECK(scene->statistics().edits.rebuilds > 2);
    }
}

TEST_CASE("a part that is far away does not hide that the others have scattered") {
    Random random(4);
    SceneDescription description = field(random, false);
    auto& parts = description.objects[1].instances;
    Scene scene = build_scene(description);
    const auto park = [&](const Transform& at) {
        parts[5].transform = at;
        SceneChanges changes;
        changes.moves = {{5, at}};
        scene = edited_by(*scene, changes);
    };
    const double built = cost_of(*scene, scene->view().root);
    const Transform home = parts[5].transform;
    park(translation(1e6F, 0, 0));
    for (int step = 0; step < 20; ++step) {
        SceneChanges changes = scatter(random, parts, false);
        std::erase_if(changes.moves, [](const auto& move) { return move.instance == 5; });
        scene = edited_by(*scene, changes);
    }
    park(translation(9e14F, 0, 0));
    park(home);
    CHECK(cost_of(*scene, scene->view().root) < 1.3 * built);
    CHECK(scene->statistics().trees.sah_cost ==
          doctest::Approx(cost_of(*scene, scene->view().root)).epsilon(1e-6));
}

TEST_CASE(
    "parts that become small elsewhere get a new tree, although the old one has become cheaper") {
    Random random(8);
    SceneDescription description = field(random, false);
    auto& parts = description.objects[1].instances;
    const auto scaled = [&](float scale) {
        const Vec3 at = random.in_box(100);
        return Transform{{scale, 0, 0, at.x, 0, scale, 0, at.y, 0, 0, scale, at.z}};
    };
    for (const float scale : {60.0F, 12.0F, 6.0F}) {
        CAPTURE(scale);
        for (InstanceDescription& part : parts) part.transform = scaled(scale);
        const Scene scene = build_scene(description);
        SceneChanges changes;
        for (std::uint32_t i = 0; i < part_count; ++i) {
            parts[i].transform = scaled(0.5F);
            changes.moves.push_back({i, parts[i].transform});
        }
        const Scene edited = edited_by(*scene, changes);
        const Scene fresh = build_scene(description);
        CHECK(edited->statistics().edits.rebuilds == 1);
        CHECK(cost_of(*edited, edited->view().root) < 1.3 * cost_of(*fresh, fresh->view().root));
    }
}

TEST_CASE("a mesh whose vertices scatter gets the tree and the leaf blocks of a new one") {
    Random random(5);
    SceneDescription description;
    description.images = {{1, 1, {0, 0, 0, 90}}};
    description.textures = {{0}};
    description.materials.resize(1);
    description.materials[0].texture = 0;
    description.materials[0].alpha_mode = AlphaMode::mask;
    description.objects.resize(2);
    GeometryDescription& mesh = description.objects[0].geometries.emplace_back();
    constexpr std::uint32_t side = 60;
    for (std::uint32_t i = 0; i < side * side; ++i) {
        const auto x = static_cast<float>(i % side), y = static_cast<float>(i / side);
        mesh.positions.emplace_back(x, y, 0);
        mesh.texcoords[0].emplace_back(x, y);
        if (i % side == side - 1 || i / side == side - 1) continue;
        for (const std::uint32_t corner : {i, i + 1, i + side, i + 1, i + side + 1, i + side})
            mesh.indices.push_back(corner);
    }
    for (const float x : {0.0F, 500.0F})
        description.objects[1].instances.push_back(place(0, translation(x, 0, 0), "mesh"));
    description.root = 1;
    for (const auto& [build, has_alpha] :
         {std::pair(BuildQuality::fast, false), std::pair(BuildQuality::medium, false),
          std::pair(BuildQuality::high, false), std::pair(BuildQuality::fast, true),
          std::pair(BuildQuality::medium, true), std::pair(BuildQuality::high, true)}) {
        CAPTURE(static_cast<int>(build));
        CAPTURE(has_alpha);
        description.build = build;
        description.objects[0].geometries[0].material = has_alpha ? 0 : no_id;
        SceneDescription now = description;
        Scene scene = build_scene(now);
        std::vector<Vec3>& positions = now.objects[0].geometries[0].positions;
        for (Vec3& p : positions) p = random.in_box(100);
        SceneChanges changes;
        for (const std::uint32_t i : {0U, 1U}) changes.deformed.push_back({i, {positions}});
        SceneChanges pose = changes;
        pose.is_last = true;
        CHECK(edited_by(*scene, pose)->statistics().edits.rebuilds == 0);
        const Scene fresh = build_scene(now);
        // Texture coordinates of alpha have room for as many leaf blocks as there were.
        const bool fits = !has_alpha || fresh->view().objects[0].block_count <=
                                            scene->view().objects[0].block_count;
        scene = edited_by(*scene, changes);
        CHECK((scene->statistics().edits.rebuilds != 0) == fits);
        CHECK(scene->digest() == fresh->digest());
        // Nothing is built again while nothing changes.
        CHECK(edited_by(*scene, changes)->statistics().edits.rebuilds ==
              scene->statistics().edits.rebuilds);
        if (!fits) continue;
        const ObjectRecord& a = scene->view().objects[0];
        const ObjectRecord& b = fresh->view().objects[0];
        REQUIRE(a.node_count == b.node_count);
        REQUIRE(a.block_count == b.block_count);
        const auto same = []<class T>(const T* ours, const T* theirs, std::uint32_t size) {
            const auto bytes = [size](const T* first) {
                return std::as_bytes(std::span(first, size));
            };
            return std::ranges::equal(bytes(ours), bytes(theirs));
        };
        CHECK(same(scene->view().nodes + a.first_node, fresh->view().nodes + b.first_node,
                   a.node_count));
        CHECK(same(scene->view().blocks + a.first_block, fresh->view().blocks + b.first_block,
                   a.block_count));
        if (has_alpha)
            CHECK(same(scene->view().attribute<TexcoordBlock>(a.texcoord_blocks),
                       fresh->view().attribute<TexcoordBlock>(b.texcoord_blocks), a.block_count));
    }
}
