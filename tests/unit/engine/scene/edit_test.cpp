// Edited scenes: rays hit what they hit in the same scene built afresh, bit for bit.
#include "engine/scene/edits/edit.h"

#include "engine/packs/registry.h"
#include "engine/scene/edits/names.h"
#include "engine/scene/edits/shared_ways.h"
#include "tests/conformance/answers.h"
#include "tests/conformance/scenes.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <set>
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

Transform random_place(Random& random, float far) {
    const Vec3 x = random.direction();
    const Vec3 y = glm::normalize(glm::cross(x, random.direction()));
    const Vec3 z = glm::cross(x, y) * random.between(0.5F, 2);
    const Vec3 at = random.in_box(far);
    return {{x.x, y.x, z.x, at.x, x.y, y.y, z.y, at.y, x.z, y.z, z.z, at.z}};
}

/// Objects: a mesh of loose triangles, one of spheres' size, a group of both, an empty one. The
/// root places them `count` times, and in half of the scenes has a triangle of its own.
SceneDescription random_scene(Random& random, std::uint32_t count) {
    SceneDescription scene;
    scene.objects.resize(5);
    for (std::uint32_t object = 0; object < 2; ++object) {
        GeometryDescription mesh;
        for (std::uint32_t i = 0; i < 3 * (object == 0 ? 40 : 3); ++i) {
            mesh.positions.push_back(random.direction() * random.unit());
            mesh.indices.push_back(i);
        }
        scene.objects[object].geometries.push_back(std::move(mesh));
    }
    for (int i = 0; i < 4; ++i)
        scene.objects[2].instances.push_back(place(random.below(2), random_place(random, 3)));
    for (std::uint32_t i = 0; i < count; ++i)
        scene.objects[4].instances.push_back(place(random.below(4), random_place(random, 40)));
    if (random.below(2) == 0) scene.objects[4].geometries.push_back(test::unit_square());
    scene.root = 4;
    return scene;
}

SceneChanges moving(std::vector<InstanceMove> moves) {
    return {std::move(moves), {}, {}, {}};
}

Scene edit(const Snapshot& scene, const SceneChanges& changes, Scene spare = nullptr) {
    auto edited = edit_scene(scene, changes, std::move(spare));
    REQUIRE_MESSAGE(edited, edited.error().message);
    // An edit leaves a valid arena, and the digest that it has.
    BuiltArena copy{Arena((*edited)->bytes().size()), 0};
    std::ranges::copy((*edited)->bytes(), copy.arena.data());
    const auto opened = Snapshot::open(std::move(copy));
    REQUIRE_MESSAGE(opened, opened.error().message);
    CHECK((*opened)->digest() == (*edited)->digest());
    return *edited;
}

std::string fault(const Snapshot& scene, const SceneChanges& changes) {
    const auto edited = edit_scene(scene, changes);
    REQUIRE(!edited);
    CHECK(edited.error().code == ErrorCode::field_invalid);
    return edited.error().message;
}

void check_same_answers(const Snapshot& edited, const Snapshot& fresh, Random& random) {
    static const auto registry = *Registry::load({{}, "auto"});
    std::vector<Ray> rays;
    for (int i = 0; i < 700; ++i) {
        const Vec3 from = random.in_box(60);
        rays.push_back({from, 0, random.in_box(40) - from});
    }
    const Variant& variant = *registry->find("opaque");
    for (const Traversal traversal : {traversal_single, traversal_packet, traversal_stream}) {
        for (const conformance::Question& question : conformance::questions) {
            const auto function = find_function(variant, question.query, traversal);
            if (!function) continue;
            const auto ours = conformance::ask(variant, *function, edited.view(), rays, question,
                                               {}, counters_none);
            const auto theirs = conformance::ask(variant, *function, fresh.view(), rays, question,
                                                 {}, counters_none);
            CHECK(conformance::differing_rays(ours, theirs).rays == 0);
        }
    }
}

/// An edited scene has the answers, bounds and digest of one that is built afresh.
void check_as_fresh(const Snapshot& edited, const SceneDescription& description, Random& random) {
    const Scene fresh = build_scene(description);
    check_same_answers(edited, *fresh, random);
    CHECK(edited.bounds().lower == fresh->bounds().lower);
    CHECK(edited.bounds().upper == fresh->bounds().upper);
    CHECK(edited.digest() == fresh->digest());
}

}  // namespace

TEST_CASE("edited scenes answer as those that are built afresh") {
    for (std::uint64_t seed = 0; seed < 12; ++seed) {
        CAPTURE(seed);
        Random random(seed);
        const std::uint32_t count = seed == 0 ? 1 : 2 + random.below(300);
        SceneDescription description = random_scene(random, count);
        auto& placed = description.objects[4].instances;
        Scene scene = build_scene(description);
        Scene spare;
        for (int step = 0; step < 5; ++step) {
            CAPTURE(step);
            std::vector<InstanceMove> moves;
            std::vector<InstanceMask> masks;
            for (std::uint32_t i = 0; i < count; ++i) {
                if (random.below(4) == 0) {
                    placed[i].transform = random_place(random, 40);
                    moves.push_back({i, placed[i].transform});
                }
                if (random.below(8) == 0) {
                    placed[i].mask = random.below(2) == 0 ? 0 : 0xFFFFFFFFU;
                    masks.push_back({i, placed[i].mask});
                }
            }
            // Every second scene leaves the memory of the epoch before to the next one.
            Scene next =
                edit(*scene, {moves, masks, {}, {}}, seed % 2 == 0 ? std::move(spare) : nullptr);
            spare = std::exchange(scene, std::move(next));
            check_as_fresh(*scene, description, random);
        }
    }
}

TEST_CASE("few moves among many instances look at the nodes above them alone") {
    Random random(11);
    SceneDescription description = random_scene(random, 6000);
    description.objects[4].geometries.clear();
    auto& placed = description.objects[4].instances;
    Scene scene = build_scene(description);
    Scene spare;
    for (int step = 0; step < 20; ++step) {
        CAPTURE(step);
        SceneChanges changes;
        std::set<std::uint32_t> chosen;
        for (int i = 0; i < 3; ++i) chosen.insert(random.below(6000));
        for (const std::uint32_t i : chosen) {
            placed[i].transform = random_place(random, 40);
            changes.moves.push_back({i, placed[i].transform});
        }
        Scene next = edit(*scene, changes, std::move(spare));
        spare = std::exchange(scene, std::move(next));
        CHECK(scene->statistics().trees.sah_cost ==
              doctest::Approx(measure_trees(scene->view()).sah_cost).epsilon(1e-9));
    }
    CHECK(scene->statistics().edits.rebuilds == 0);
    check_as_fresh(*scene, description, random);
}

TEST_CASE("what is placed several times moves and hides at the one place that is named") {
    for (std::uint64_t seed = 0; seed < 8; ++seed) {
        CAPTURE(seed);
        Random random(seed);
        SceneDescription description = random_scene(random, 60);
        Scene scene = build_scene(description);
        for (int step = 0; step < 3; ++step) {
            SceneChanges changes;
            for (std::uint32_t i = 0; i < 60; ++i) {
                // The copy of the group that this place has from now on, in the description that is
                // built afresh.
                const std::uint32_t group = description.objects[4].instances[i].object;
                if (group != 2 && group < 5) continue;
                if (random.below(3) != 0) continue;
                const ObjectDescription copy = description.objects[group];
                description.objects[4].instances[i].object =
                    static_cast<std::uint32_t>(description.objects.size());
                auto& inside = description.objects.emplace_back(copy).instances;
                const std::uint32_t place = random.below(4);
                inside[place].transform = random_place(random, 3);
                changes.moves.push_back({{i, {place}}, inside[place].transform});
                if (random.below(2) == 0) continue;
                inside[3 - place].mask = random.below(2) == 0 ? 0 : 0xFFFFFFFFU;
                changes.masks.push_back({{i, {3 - place}}, inside[3 - place].mask});
            }
            if (random.below(2) == 0) {
                auto& outer = description.objects[4].instances[5];
                outer.transform = random_place(random, 40);
                changes.moves.push_back({5, outer.transform});
            }
            const std::size_t before = scene->bytes().size();
            const std::uint64_t more = bytes_to_unshare(*scene, *shared_ways(*scene, changes));
            scene = edit(*scene, changes);
            constexpr std::size_t between_sections = 22 * 64;
            CHECK(scene->bytes().size() <= before + more + between_sections);
            CHECK(bytes_to_unshare(*scene, *shared_ways(*scene, changes)) == 0);
            check_as_fresh(*scene, description, random);
        }
        // Each place has a group of its own by now: such an edit copies no object any more.
        const std::size_t bytes = scene->bytes().size();
        for (std::uint32_t i = 0; i < 60; ++i)
            if (description.objects[4].instances[i].object >= 5) {
                scene = edit(*scene, moving({{{i, {1}}, translation(0, 1, 0)}}));
                break;
            }
        CHECK(scene->bytes().size() == bytes);
    }
}

TEST_CASE("instances go and scenes come, and the others keep their names") {
    for (std::uint64_t seed = 0; seed < 8; ++seed) {
        CAPTURE(seed);
        Random random(seed);
        SceneDescription description = random_scene(random, 40);
        description.objects[4].name = "all";
        for (std::uint32_t i = 0; i < 40; ++i)
            description.objects[4].instances[i].name = "part" + std::to_string(i);
        description.objects[4].instances[9].object = 0;  // an empty object has no path
        const bool has_own = !description.objects[4].geometries.empty();
        SceneDescription more = test::tree_scene();
        more.origin = {};
        const Scene added = build_scene(more);
        Scene scene = build_scene(description);
        // The objects of the added scene, in the description that is built afresh.
        const auto first = static_cast<std::uint32_t>(description.objects.size());
        for (ObjectDescription object : more.objects) {
            for (InstanceDescription& instance : object.instances) instance.object += first;
            description.objects.push_back(std::move(object));
        }
        SceneChanges changes;
        if (has_own) {
            // The root becomes an instance, because its tree is not built again.
            ObjectDescription& outer = description.objects.emplace_back();
            outer.instances.push_back(place(4, Transform{}, "all"));
            description.root = static_cast<std::uint32_t>(description.objects.size() - 1);
        }
        auto& placed = description.objects[description.root].instances;
        if (!has_own) {
            changes.removed = {0, 7, 8, 39};
            for (const int i : {39, 8, 7, 0}) placed.erase(placed.begin() + i);
        }
        AddedScene& twice = changes.added.emplace_back(AddedScene{added, "tree", {}, {}});
        for (int i = 0; i < 2; ++i) {
            twice.to_scene.push_back(random_place(random, 30));
            twice.masks.push_back(i == 0 ? ~0U : 4U);
            placed.push_back(place(first + more.root, twice.to_scene.back(), "tree"));
            placed.back().mask = twice.masks.back();
        }
        scene = edit(*scene, changes);
        check_same_answers(*scene, *build_scene(description), random);
        const auto has = [&](const char* text) { return find_path(*scene, text).has_value(); };
        CHECK(has("tree#0/second/low"));
        CHECK(has("tree#1/third"));
        CHECK(!has("tree#2/third"));
        if (!has_own) {
            CHECK(!has("part7"));
            CHECK(InstanceFinder(*scene, [] { return false; }).find("part9")->front() ==
                  InstancePlace(6));
        } else {
            CHECK(InstanceFinder(*scene, [] { return false; }).find("all/part9").has_value());
        }
        // Once more: the numbers count on, and what is there already is not stored again.
        const std::size_t objects = scene->view().object_count;
        SceneChanges third;
        third.added.push_back({added, "tree", {translation(50, 0, 0)}, {~0U}});
        scene = edit(*scene, third);
        CHECK(has("tree#2/third"));
        CHECK(scene->view().object_count == objects);
        placed.push_back(place(first + more.root, translation(50, 0, 0), "tree"));
        check_same_answers(*scene, *build_scene(description), random);
        // Objects that nothing places any more are gone.
        SceneChanges away;
        const auto trees = InstanceFinder(*scene, [] { return false; }).find("tree#*");
        REQUIRE_MESSAGE(trees, trees.error().message);
        for (const InstancePlace& tree : *trees) away.removed.push_back(tree.outermost);
        scene = edit(*scene, away);
        CHECK(!has("tree#1/third"));
        CHECK(scene->view().object_count < objects);
    }
}

TEST_CASE("the tree of the root is built again when its expected cost has grown") {
    Random random(5);
    SceneDescription description = random_scene(random, 400);
    description.objects[4].geometries.clear();
    auto& placed = description.objects[4].instances;
    Scene scene = build_scene(description);
    for (std::uint32_t i = 0; i < 3; ++i) {
        placed[i].transform.m[3] += 0.1F;
        scene = edit(*scene, moving({{i, placed[i].transform}}));
    }
    CHECK(scene->statistics().edits.refits == 3);
    CHECK(scene->statistics().edits.rebuilds == 0);
    for (int step = 0; step < 30; ++step) {
        std::vector<InstanceMove> moves;
        for (int i = 0; i < 10; ++i) {
            const std::uint32_t a = 2 * random.below(200);
            if (std::ranges::any_of(moves, [&](const auto& m) { return m.instance == a; }))
                continue;
            std::swap(placed[a].transform, placed[a + 1].transform);
            moves.push_back({a, placed[a].transform});
            moves.push_back({a + 1, placed[a + 1].transform});
        }
        scene = edit(*scene, moving(moves));
    }
    CHECK(scene->statistics().edits.rebuilds > 0);
    const Scene fresh = build_scene(description);
    check_same_answers(*scene, *fresh, random);
    CHECK(scene->statistics().trees.sah_cost <= 1.25 * fresh->statistics().trees.sah_cost);
}

TEST_CASE("instances are found by the texts of their paths, and '*' stands for any text") {
    CHECK(glob_matches("car", "car"));
    CHECK(glob_matches("car", "car/wheel/tyre"));
    CHECK(glob_matches("car#*", "car#12/wheel"));
    CHECK(glob_matches("*wheel*", "car/wheel#3"));
    CHECK(glob_matches("*", "anything"));
    CHECK(!glob_matches("car", "cart"));
    CHECK(!glob_matches("car#1", "car#12"));
    CHECK(!glob_matches("wheel", "car/wheel"));
    CHECK(!glob_matches("", "car"));
    const Scene scene = build_scene(test::tree_scene());
    const auto find = [&](const char* text) {
        return InstanceFinder(*scene, [] { return false; }).find(text);
    };
    CHECK(*find("second") == std::vector<InstancePlace>{1});
    CHECK(*find("*") == std::vector<InstancePlace>{0, 1, 2, 3});
    CHECK(*find("*ir*") == std::vector<InstancePlace>{0, 3});
    CHECK(*find("*l*") == std::vector<InstancePlace>{
                              {0, {0}}, {0, {1}}, {1, {0}}, {1, {1}}, 2, {3, {0}}, {3, {1}}});
    CHECK(*find("first/low") == std::vector<InstancePlace>{{0, {0}}});
    CHECK(*find("*/leaf") == std::vector<InstancePlace>{{0, {1}}, {1, {1}}, {3, {1}}});
    CHECK(find("fourth").error().message.find("there are: first, second") != std::string::npos);
    CHECK(find("x*").error().message == "no path is of the form 'x*'");
    CHECK(!InstanceFinder(*scene, [] { return true; }).find("*"));
}

TEST_CASE("a whole text finds the outermost instance that has its paths and no others") {
    Random random(9);
    SceneDescription alone = test::tree_scene();  // below its root stands the whole tree alone
    alone.objects.emplace_back().instances.push_back(
        place(alone.root, translation(1, 2, 3), "all"));
    alone.root = static_cast<std::uint32_t>(alone.objects.size()) - 1;
    for (const SceneDescription& description :
         {test::tree_scene(), alone, random_scene(random, 30)}) {
        const Scene scene = build_scene(description);
        const SceneView& view = scene->view();
        std::vector<std::string> texts;
        for (std::uint64_t path = 0; path < scene->statistics().instances; ++path)
            texts.push_back(path_name(*expand_path(*scene, path)));
        for (const std::string& whole : texts) {
            for (std::size_t end = whole.find('/');; end = whole.find('/', end + 1)) {
                const std::string text = whole.substr(0, end);
                CAPTURE(text);
                const auto found = InstanceFinder(*scene, [] { return false; }).find_parts(text);
                REQUIRE_MESSAGE(found, found.error().message);
                if (found->instances.size() == 1 && found->own.empty()) {
                    const InstancePlace& it = found->instances.front();
                    std::uint32_t object = view.root;
                    std::uint64_t first = 0, above = 0;
                    std::vector<std::uint32_t> way{it.outermost};
                    way.insert(way.end(), it.below.begin(), it.below.end());
                    for (const std::uint32_t at : way) {
                        above = view.objects[object].placement_count;
                        const auto& instance =
                            view.instances[view.objects[object].first_instance + at];
                        first += instance.path_base;
                        object = instance.object;
                    }
                    const std::uint64_t count = view.objects[object].placement_count;
                    for (std::uint64_t path = 0; path < texts.size(); ++path)
                        CHECK((path >= first && path < first + count) ==
                              glob_matches(text, texts[path]));
                    CHECK((way.size() == 1 || above > count));
                }
                if (end == std::string::npos) break;
            }
        }
    }
}

TEST_CASE("texts that are longer than a finder keeps are found as others are") {
    SceneDescription scene;
    scene.objects.resize(2);
    scene.objects[0].geometries.push_back(test::unit_square());
    constexpr std::uint32_t count = 40;
    for (std::uint32_t i = 0; i < count; ++i) {
        scene.objects[1].instances.push_back(place(0, translation(static_cast<float>(i), 0, 0)));
        scene.objects[1].instances.back().name = std::to_string(i % 7) + std::string(230, 'x');
    }
    scene.root = 1;
    const Scene built = build_scene(scene);
    InstanceFinder finder(*built, [] { return false; });
    for (int round = 0; round < 2; ++round)
        for (std::uint32_t ending = 0; ending < 7; ++ending) {
            const auto found = finder.find(std::to_string(ending) + "xx*");
            REQUIRE(found);
            std::vector<InstancePlace> wanted;
            for (std::uint32_t i = ending; i < count; i += 7) wanted.emplace_back(i);
            CHECK(*found == wanted);
        }
}

TEST_CASE("what cannot be edited is refused by name, and the scene stays as it is") {
    const Scene scene = build_scene(test::tree_scene());
    const std::string before = scene->digest();
    const Transform here = translation(1, 2, 3);
    CHECK(fault(*scene, moving({{4, here}})) ==
          "there is no outermost instance 4: the scene has 4");
    CHECK(fault(*scene, {{}, {{9, 0}}, {}, {}}).find("instance 9") != std::string::npos);
    CHECK(fault(*scene, moving({{1, here}, {1, here}})).find("named twice") != std::string::npos);
    CHECK(fault(*scene, moving({{2, test::scaling(1, 0, 1)}})).find("'lone' is singular") !=
          std::string::npos);
    Transform odd = here;
    odd.m[7] = std::numeric_limits<float>::quiet_NaN();
    CHECK(fault(*scene, moving({{2, odd}})).find("not finite") != std::string::npos);
    CHECK(fault(*scene, moving({{2, translation(2e15F, 0, 0)}})).find("1e15") != std::string::npos);
    SceneChanges far;
    far.added.push_back({scene, "more", {translation(2e15F, 0, 0)}, {~0U}});
    CHECK(fault(*scene, far).find("1e15") != std::string::npos);
    far.added.front().to_scene = {test::scaling(1, 0, 1)};
    CHECK(fault(*scene, far).find("'more' is singular") != std::string::npos);
    CHECK(fault(*scene, {{}, {}, {4}, {}}).find("not in the scene") != std::string::npos);
    CHECK(fault(*scene, moving({{{0, {2}}, here}})).find("within 'first'") != std::string::npos);
    CHECK(fault(*scene, moving({{{0, {0}}, translation(2e15F, 0, 0)}}))
              .find("'first/low' would reach") != std::string::npos);
    CHECK(scene->digest() == before);
    // Nothing changes nothing but the number of edits; back where it was, it is the same content.
    const Scene there = edit(*scene, moving({{2, here}}));
    CHECK(there->digest() != before);
    CHECK(edit(*there, moving({{2, translation(20, 0, 0)}}))->digest() == before);
}

TEST_CASE("what user ids and materials of shared objects cost is known before") {
    SceneDescription scene;
    scene.objects.resize(4);
    GeometryDescription square = test::unit_square();
    square.material = 0;
    scene.materials.resize(2);
    scene.objects[0].geometries.push_back(std::move(square));
    Random random(5);
    for (int i = 0; i < 50; ++i)
        scene.objects[1].instances.push_back(place(0, random_place(random, 3)));
    scene.objects[2].instances.push_back(place(1, random_place(random, 3)));
    for (int i = 0; i < 20; ++i)
        scene.objects[3].instances.push_back(place(2, random_place(random, 40)));
    scene.root = 3;
    const Scene before = build_scene(scene);
    constexpr std::size_t between_sections = 22 * 64;
    SceneChanges uids, materials;
    for (std::uint32_t i = 0; i < 20; ++i) uids.uids.push_back({i, 7 + i});
    for (const std::uint32_t i : {3U, 4U, 17U})
        for (std::uint32_t leaf = 0; leaf < 50; leaf += 7)
            materials.materials.push_back({{i, {0, leaf}}, 1});
    for (const SceneChanges& changes : {uids, materials}) {
        const std::uint64_t more = bytes_to_unshare(*before, *shared_ways(*before, changes));
        const Scene after = edit(*before, changes);
        CHECK(after->bytes().size() > before->bytes().size());
        // It is made of as much again.
        CHECK(2 * (after->bytes().size() - before->bytes().size()) <= more + between_sections);
    }
}
