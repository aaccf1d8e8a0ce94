// Masks of edited scenes: a group keeps the one that it was given, whatever its contents have.
#include "engine/scene/edits/edit.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

using namespace raynest;
using conformance::Random;
using test::build_scene;
using test::place;
using test::translation;

namespace {

using Scene = std::shared_ptr<const Snapshot>;
constexpr std::uint32_t all_rays = 0xFFFFFFFF;

/// Objects: a square, a group of three, a group of two of those and a square; the root places two of these.
SceneDescription nested_groups() {
    SceneDescription scene;
    scene.objects.resize(4);
    scene.objects[0].geometries = {test::unit_square()};
    const auto at = [](int i) { return translation(0, 0, static_cast<float>(i)); };
    for (int i = 0; i < 3; ++i) scene.objects[1].instances.push_back(place(0, at(i), "leaf"));
    for (int i = 0; i < 2; ++i) scene.objects[2].instances.push_back(place(1, at(5 * i), "twig"));
    scene.objects[2].instances.push_back(place(0, at(20), "bark"));
    for (int i = 0; i < 2; ++i) scene.objects[3].instances.push_back(place(2, at(50 * i), "tree"));
    scene.root = 3;
    return scene;
}

/// Gives the second placement of each shared object one of its own, so that each has its masks.
SceneDescription apart(const SceneDescription& scene) {
    SceneDescription made;
    const auto copy = [&](auto& self, std::uint32_t object) -> std::uint32_t {
        ObjectDescription one = scene.objects[object];
        for (InstanceDescription& instance : one.instances)
            instance.object = self(self, instance.object);
        made.objects.push_back(std::move(one));
        return static_cast<std::uint32_t>(made.objects.size()) - 1;
    };
    made.root = copy(copy, scene.root);
    return made;
}

InstanceDescription& instance_at(SceneDescription& scene, const InstancePlace& place) {
    InstanceDescription* found = &scene.objects[scene.root].instances[place.outermost];
    for (const std::uint32_t at : place.below) found = &scene.objects[found->object].instances[at];
    return *found;
}

void check_as_fresh(const Scene& scene, const SceneDescription& description) {
    const Scene fresh = build_scene(description);
    CHECK(scene->digest() == fresh->digest());
    // The digest has the masks that were given; opening an arena checks that the others follow.
    BuiltArena copy{Arena(scene->bytes().size()), 0};
    std::ranges::copy(scene->bytes(), copy.arena.data());
    CHECK(Snapshot::open(std::move(copy)));
}

Scene with_masks(const Scene& scene, const SceneChanges& changes) {
    auto edited = edit_scene(*scene, changes);
    REQUIRE_MESSAGE(edited, edited.error().message);
    return *edited;
}

std::uint32_t outermost_mask(const Scene& scene, std::uint32_t place) {
    const SceneView& view = scene->view();
    return view.instances[view.objects[view.root].first_instance + place].mask;
}

}  // namespace

TEST_CASE("a hidden group stays hidden while its contents are hidden and shown") {
    SceneDescription description = apart(nested_groups());
    Scene scene = build_scene(description);
    const auto set = [&](const InstancePlace& at, std::uint32_t mask) {
        instance_at(description, at).mask = mask;
        SceneChanges changes;
        changes.masks = {{at, mask}};
        scene = with_masks(scene, changes);
        check_as_fresh(scene, description);
    };
    set(0, 0);
    for (const std::uint32_t twig : {0U, 1U}) set({0, {twig}}, 0);
    set({0, {2}}, 0);
    set({0, {1}}, all_rays);
    CHECK(outermost_mask(scene, 0) == 0);
    set(0, all_rays);
    CHECK(outermost_mask(scene, 0) == all_rays);
    set({0, {1}}, 0);
    CHECK(outermost_mask(scene, 0) == 0);
}

TEST_CASE("a group lets in no ray that its own mask does not, whatever stands in it") {
    SceneDescription description = apart(nested_groups());
    instance_at(description, 1).mask = 1;
    for (const std::uint32_t i : {0U, 1U, 2U}) instance_at(description, {1, {i}}).mask = 1;
    Scene scene = build_scene(description);
    CHECK(outermost_mask(scene, 1) == 1);
    SceneChanges changes;
    changes.masks = {{{1, {2}}, 2}};
    instance_at(description, {1, {2}}).mask = 2;
    scene = with_masks(scene, changes);
    CHECK(outermost_mask(scene, 1) == 1);
    check_as_fresh(scene, description);
}

TEST_CASE("masks on all levels are those of a scene that is built afresh") {
    constexpr std::uint32_t masks[] = {0, 1, 2, 3, all_rays};
    const std::vector<InstancePlace> places{0,        1,           {0, {0}},    {0, {1}},
                                            {0, {2}}, {0, {0, 1}}, {0, {1, 2}}, {1, {0}},
                                            {1, {1}}, {1, {0, 0}}, {1, {0, 1}}, {1, {0, 2}}};
    for (std::uint64_t seed = 0; seed < 10; ++seed) {
        CAPTURE(seed);
        Random random(seed);
        SceneDescription description = apart(nested_groups());
        Scene scene = build_scene(nested_groups());  // whose groups are shared
        for (int step = 0; step < 8; ++step) {
            SceneChanges changes;
            for (const InstancePlace& at : places) {
                if (random.below(3) != 0) continue;
                const std::uint32_t mask = masks[random.below(5)];
                changes.masks.push_back({at, mask});
                instance_at(description, at).mask = mask;
            }
            scene = with_masks(scene, changes);
            check_as_fresh(scene, description);
        }
    }
}
