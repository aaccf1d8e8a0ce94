// Parts of scenes that are hidden: rays hit what they hit in the whole scene, less those hits.
#include "engine/packs/registry.h"
#include "engine/scene/selection/find_parts.h"
#include "tests/conformance/answers.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

using namespace raynest;
using conformance::Random;
using test::build_scene;
using test::place;
using test::translation;

namespace {

using Scene = std::shared_ptr<const Snapshot>;

GeometryDescription loose_triangles(Random& random, std::uint32_t count) {
    GeometryDescription mesh;
    for (std::uint32_t i = 0; i < 3 * count; ++i) {
        mesh.positions.push_back(random.direction() * random.unit() * 3.0F);
        mesh.indices.push_back(i);
    }
    return mesh;
}

/// Two meshes, groups of them, and groups of groups, some of which have triangles of their own
/// beside their instances; all are shared.
SceneDescription random_scene(Random& random) {
    SceneDescription scene;
    scene.objects.resize(6);
    scene.objects[0].geometries.push_back(loose_triangles(random, 30));
    scene.objects[1].geometries.push_back(loose_triangles(random, 2));
    for (std::uint32_t object = 2; object < 6; ++object) {
        const std::uint32_t count = 2 + random.below(object == 5 ? 12 : 4);
        for (std::uint32_t i = 0; i < count; ++i)
            scene.objects[object].instances.push_back(place(
                random.below(object),
                translation(random.between(-9, 9), random.between(-9, 9), random.between(-9, 9))));
        if (random.below(2) == 0)
            scene.objects[object].geometries.push_back(
                loose_triangles(random, 1 + random.below(20)));
    }
    scene.root = 5;
    return scene;
}

/// A part, and the range of its paths.
struct RangedPart {
    ScenePart part;
    std::uint64_t first = 0, count = 0;

    [[nodiscard]] bool holds(std::uint64_t path) const { return path - first < count; }
};

/// Returns the part on the way to a path that is `steps` deep, or as deep as there are.
RangedPart part_above(const SceneView& scene, std::uint64_t path, std::size_t steps) {
    RangedPart made{*part_of(scene, path), path, 1};
    if (made.part.way.size() <= steps || steps == 0) return made;
    made.part.way.resize(steps);
    made.part.own = false;
    std::uint32_t object = scene.root;
    made.first = 0;
    for (const std::uint32_t place : made.part.way) {
        const InstanceRecord& instance =
            scene.instances[scene.objects[object].first_instance + place];
        made.first += instance.path_base;
        object = instance.object;
    }
    made.count = scene.objects[object].placement_count;
    return made;
}

bool holds(const std::vector<RangedPart>& parts, std::uint64_t path) {
    return std::ranges::any_of(parts, [&](const RangedPart& each) { return each.holds(path); });
}

/// The hits of a ray, as bytes without flags.
std::vector<HitRecord> plain(std::span<const HitRecord> hits) {
    std::vector<HitRecord> all;
    for (HitRecord hit : hits) {
        if (hit.hit == 0) continue;
        hit.flags = 0;
        all.push_back(hit);
    }
    return all;
}

}  // namespace

TEST_CASE("parts are hidden at one place of shared objects, and nothing else is") {
    const auto registry = *Registry::load({{}, "auto"});
    const Variant& variant = *registry->find("opaque");
    int copied = 0, in_place = 0, without_own = 0;
    for (std::uint64_t seed = 0; seed < 60; ++seed) {
        CAPTURE(seed);
        Random random(seed);
        const Scene scene = build_scene(random_scene(random));
        const SceneView& view = scene->view();
        std::vector<RangedPart> hidden, only;
        const auto choose = [&](std::vector<RangedPart>& parts, std::uint32_t most) {
            for (std::uint32_t i = 0; i < most; ++i)
                parts.push_back(part_above(
                    view, random.below(static_cast<std::uint32_t>(scene->statistics().instances)),
                    1 + random.below(3)));
        };
        if (seed % 3 != 1) choose(hidden, 1 + random.below(5));
        if (seed % 3 != 0) choose(only, 1 + random.below(5));
        InstanceLists lists;
        for (const RangedPart& each : hidden) lists.hidden_parts.push_back(each.part);
        for (const RangedPart& each : only) lists.only_parts.push_back(each.part);
        lists.only_named = !only.empty();
        const bool skips_boxes = random.below(2) == 0;
        const SelectedInstances selected(view, lists.selection(), skips_boxes);
        const auto size = SelectedInstances::size(view, lists.selection(), skips_boxes);
        CHECK(size.instances == selected.view().instance_count);
        (selected.has_copies() ? copied : in_place) += 1;
        for (const RangedPart& each : hidden) without_own += each.part.own ? 1 : 0;

        std::vector<Ray> rays;
        for (int i = 0; i < 300; ++i) {
            const Vec3 from = random.in_box(40);
            rays.push_back({from, 0, random.in_box(20) - from});
        }
        const auto whole =
            conformance::ask(variant, *find_function(variant, query_all, traversal_single), view,
                             rays, {query_all, 4096}, {}, counters_none);
        for (const Traversal traversal :
             {traversal_single, traversal_packet, traversal_stream, traversal_reference}) {
            CAPTURE(traversal);
            for (const conformance::Question& question : conformance::questions) {
                const auto function = find_function(variant, question.query, traversal);
                if (!function) continue;
                const auto ours = conformance::ask(variant, *function, selected.view(), rays,
                                                   question, {}, counters_none);
                std::size_t wrong = 0;
                for (std::size_t ray = 0; ray < rays.size(); ++ray) {
                    std::vector<HitRecord> wanted = plain(whole.of(ray));
                    std::erase_if(wanted, [&](const HitRecord& hit) {
                        return holds(hidden, hit.path) || (!only.empty() && !holds(only, hit.path));
                    });
                    std::vector<HitRecord> found = plain(ours.of(ray));
                    if (question.query == query_any) {
                        wrong += found.empty() != wanted.empty();
                        continue;
                    }
                    for (HitRecord& hit : found) hit.object = selected.object_in_scene(hit.object);
                    wanted.resize(std::min<std::size_t>(wanted.size(), question.hits_max));
                    wrong += !conformance::same_bytes(found, wanted);
                }
                CHECK(wrong == 0);
            }
        }
    }
    // All that the test is about has happened.
    CHECK(copied > 10);
    CHECK(in_place > 0);
    CHECK(without_own > 3);
}

TEST_CASE("texts and ids of paths stand for parts") {
    SceneDescription description;
    description.objects.resize(3);
    description.objects[0].geometries.push_back(test::unit_square());
    description.objects[1].instances = {place(0, translation(0, 0, 1), "wheel-0"),
                                        place(0, translation(0, 0, 2), "wheel-1"),
                                        place(0, translation(0, 0, 3), "body")};
    description.objects[1].geometries.push_back(test::unit_square());
    description.objects[2].instances = {place(1, translation(0, 0, 0), "car"),
                                        place(1, translation(5, 0, 0), "van")};
    description.root = 2;
    const Scene scene = build_scene(description);
    const auto parts = [&](const PathNames& hidden, const PathNames& only = {}) {
        InstanceLists lists;
        const auto found = find_parts(
            *scene, hidden, only, [] { return false; }, lists);
        REQUIRE_MESSAGE(found, found.error().message);
        return lists;
    };
    CHECK(parts({{"car"}, {}}).hidden_instances == std::vector{0U});
    CHECK(parts({{"van/wheel*"}, {}}).hidden_parts ==
          std::vector<ScenePart>{{{1, 0}, false}, {{1, 1}, false}});
    CHECK(parts({{"*body"}, {}}).hidden_parts ==
          std::vector<ScenePart>{{{0, 2}, false}, {{1, 2}, false}});
    // Path 0 is the square that the car has beside its wheels, path 4 that of the van.
    CHECK(parts({{}, {0, 5}}).hidden_parts == std::vector<ScenePart>{{{0}, true}, {{1, 0}, false}});
    const InstanceLists only = parts({}, {{"van"}, {1}});
    CHECK(only.only_instances == std::vector{1U});
    CHECK(only.only_parts == std::vector<ScenePart>{{{0, 0}, false}});
    CHECK(only.only_named);

    const auto fault = [&](const PathNames& hidden, const PathNames& none = {}) {
        InstanceLists lists;
        const auto found = find_parts(
            *scene, hidden, none, [] { return false; }, lists);
        REQUIRE(!found);
        return found.error().message;
    };
    CHECK(fault({{"car/door"}, {}}).find("'car' has no 'door'; there are: wheel-0") == 0);
    CHECK(fault({{"car/wheel*", "bus*"}, {}}) == "no path is of the form 'bus*'");
    CHECK(fault({{}, {8}}) == "there is no path 8: the scene has 8");
    CHECK(fault({{"car"}, {}}, {{"car"}, {}}) ==
          "`hide` and `only` both name 'car': leave it out of one of them");
    CHECK(fault({{}, {3}}, {{}, {3}}).find("path 3") != std::string::npos);
}

TEST_CASE("a scene that is one mesh may be hidden") {
    const auto registry = *Registry::load({{}, "auto"});
    const Variant& variant = *registry->find("opaque");
    const Scene scene = test::square(1);
    InstanceLists lists;
    REQUIRE(find_parts(
        *scene, {{}, {0}}, {}, [] { return false; }, lists));
    const SelectedInstances selected(scene->view(), lists.selection(), false);
    const std::vector<Ray> rays{{{0.25F, 0.25F, 5}, 0, {0, 0, -1}}};
    for (const Traversal traversal :
         {traversal_single, traversal_packet, traversal_stream, traversal_reference}) {
        const auto function = find_function(variant, query_closest, traversal);
        if (!function) continue;
        const auto hit = [&](const SceneView& view) {
            return conformance::ask(variant, *function, view, rays, {query_closest, 1}, {},
                                    counters_none)
                .of(0)[0]
                .hit;
        };
        CHECK(hit(scene->view()) == 1);
        CHECK(hit(selected.view()) == 0);
    }
}
