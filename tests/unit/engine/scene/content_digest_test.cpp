// A scene's digest tells apart all that changes an answer, and nothing else.
#include "engine/scene/content_digest.h"

#include "engine/scene/format.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <array>
#include <cstddef>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

using namespace raynest;
using test::build_scene;
using test::place;
using test::translation;

namespace {

void set_spheres(ObjectDescription& object, const std::vector<Vec4>& spheres) {
    object.record_type = "sphere";
    object.records.resize(spheres.size() * sizeof(Vec4));
    std::memcpy(object.records.data(), spheres.data(), object.records.size());
    object.record_bounds.clear();
    for (const Vec4& s : spheres)
        object.record_bounds.push_back({Vec3(s) - Vec3(s.w), Vec3(s) + Vec3(s.w)});
}

/// Two squares and some spheres, with all that a scene may have.
SceneDescription rich_scene() {
    SceneDescription scene = test::tree_scene();
    scene.images = {{2, 1, {10, 20, 30, 255, 40, 50, 60, 70}}};
    scene.textures = {{0}};
    scene.materials.resize(2);
    scene.materials[0].name = "leaf";
    scene.materials[0].texture = 0;
    scene.materials[0].alpha_mode = AlphaMode::mask;
    scene.materials[1].surface.emission = {1, 2, 3};
    for (int object = 0; object < 2; ++object) {
        GeometryDescription& square = scene.objects[static_cast<std::size_t>(object)].geometries[0];
        square.material = 0;
        square.normals.assign(4, {0, 0, 1});
        square.tangents.assign(4, {1, 0, 0, 1});
        square.colours.assign(16, 200);
    }
    scene.objects.push_back({});
    set_spheres(scene.objects[3], {{0, 0, 0, 1}, {5, 1, 2, 0.5F}, {9, 2, 3, 0.25F}});
    std::swap(scene.objects[2], scene.objects[3]);
    scene.objects[3].instances.push_back(place(2, translation(3, 3, 3), "balls"));
    scene.root = 3;
    scene.cameras = {{"near", translation(0, 0, 5)}};
    scene.lights = {{"lamp", {}}};
    scene.variants = {"summer", "winter"};
    scene.chosen_variant = 1;
    return scene;
}

std::string digest_of(const SceneDescription& scene) {
    return build_scene(scene)->digest();
}

}  // namespace

TEST_CASE("each part of a scene has a share in its digest") {
    const std::map<std::string, std::function<void(SceneDescription&)>> changes{
        {"transform", [](auto& s) { s.objects[1].instances[0].transform.m[3] += 1; }},
        {"mask", [](auto& s) { s.objects[1].instances[0].mask = 5; }},
        {"user id", [](auto& s) { s.objects[1].instances[0].uid = 5; }},
        {"name of an instance", [](auto& s) { s.objects[1].instances[1].name = "high"; }},
        {"long name", [](auto& s) { s.objects[1].instances[1].name = std::string(200, 'a'); }},
        {"longer name", [](auto& s) { s.objects[1].instances[1].name = std::string(201, 'a'); }},
        {"name of an object", [](auto& s) { s.objects[0].name = "petal"; }},
        {"order of instances",
         [](auto& s) { std::swap(s.objects[3].instances[0], s.objects[3].instances[1]); }},
        {"other object", [](auto& s) { s.objects[3].instances[2].object = 1; }},
        {"vertex", [](auto& s) { s.objects[0].geometries[0].positions[2].x += 1; }},
        {"index",
         [](auto& s) {
             std::swap(s.objects[0].geometries[0].indices[0],
                       s.objects[0].geometries[0].indices[1]);
         }},
        {"texture coordinate", [](auto& s) { s.objects[0].geometries[0].texcoords[0][1].x = 3; }},
        {"second set", [](auto& s) { s.objects[0].geometries[0].texcoords[1].assign(4, Vec2(0)); }},
        {"colour", [](auto& s) { s.objects[0].geometries[0].colours[3] = 1; }},
        {"normal",
         [](auto& s) {
             s.objects[0].geometries[0].normals[1] = {0, 1, 0};
         }},
        {"no normals", [](auto& s) { s.objects[0].geometries[0].normals.clear(); }},
        {"tangent", [](auto& s) { s.objects[0].geometries[0].tangents[1].w = -1; }},
        {"material", [](auto& s) { s.objects[0].geometries[0].material = 1; }},
        {"no material", [](auto& s) { s.objects[0].geometries[0].material = no_id; }},
        {"sphere",
         [](auto& s) {
             set_spheres(s.objects[2], {{0, 0, 0, 1}, {5, 1, 2, 0.5F}});
         }},
        {"order of spheres",
         [](auto& s) {
             set_spheres(s.objects[2], {{5, 1, 2, 0.5F}, {0, 0, 0, 1}, {9, 2, 3, 0.25F}});
         }},
        {"pixel", [](auto& s) { s.images[0].rgba[4] = 41; }},
        {"alpha", [](auto& s) { s.images[0].rgba[7] = 71; }},
        {"wrap", [](auto& s) { s.textures[0].wrap_t = Wrap::clamp; }},
        {"filter", [](auto& s) { s.textures[0].nearest = true; }},
        {"cutoff", [](auto& s) { s.materials[0].cutoff = 0.25F; }},
        {"roughness", [](auto& s) { s.materials[0].surface.roughness = 0.25F; }},
        {"name of a material", [](auto& s) { s.materials[1].name = "sun"; }},
        {"emission of a material that nothing has",
         [](auto& s) { s.materials[1].surface.emission.x = 2; }},
        {"camera", [](auto& s) { s.cameras[0].to_world.m[11] = 6; }},
        {"name of a camera", [](auto& s) { s.cameras[0].name = "far"; }},
        {"light",
         [](auto& s) {
             s.lights[0].light.intensity = {1, 1, 1};
         }},
        {"name of a light", [](auto& s) { s.lights[0].name = "torch"; }},
        {"origin", [](auto& s) { s.origin[1] = 100; }},
        {"up", [](auto& s) { s.up = UpAxis::z; }},
        {"build", [](auto& s) { s.build = BuildQuality::high; }},
        {"variant", [](auto& s) { s.chosen_variant = 2; }},
        {"name of a variant", [](auto& s) { s.variants[1] = "autumn"; }},
    };
    std::map<std::string, std::string> seen{{digest_of(rich_scene()), "as it was"}};
    CHECK(digest_of(rich_scene()) == seen.begin()->first);
    for (const auto& [name, change] : changes) {
        CAPTURE(name);
        SceneDescription scene = rich_scene();
        change(scene);
        const auto [same, is_new] = seen.emplace(digest_of(scene), name);
        CHECK_MESSAGE(is_new, "as " << same->second);
    }
}

TEST_CASE("what changes no answer has no share in the digest") {
    SceneDescription scene = rich_scene();
    const std::string digest = digest_of(scene);
    SUBCASE("which objects are shared") {
        // The second twig gets an object of its own, with a leaf of its own.
        ObjectDescription leaf = scene.objects[0];
        ObjectDescription twig = scene.objects[1];
        scene.objects.push_back(leaf);
        twig.instances[1].object = 4;
        scene.objects.push_back(twig);
        scene.objects[3].instances[1].object = 5;
    }
    SUBCASE("objects that nothing places") {
        scene.objects.push_back(scene.objects[0]);
    }
    SUBCASE("warnings and what was skipped") {
        scene.warnings = {"something"};
        scene.skipped = {{"something", 3}};
    }
    SUBCASE("a texture that is there twice") {
        scene.images.push_back(scene.images[0]);
        scene.textures.push_back({1});
        scene.materials[0].texture = 1;
    }
    CHECK(digest_of(scene) == digest);
}

TEST_CASE("vertices that overlap in an arena are refused, not hashed again and again") {
    const auto scene = build_scene(test::tree_scene());
    BuiltArena copy{Arena(scene->bytes().size()), 0};
    std::memcpy(copy.arena.data(), scene->bytes().data(), scene->bytes().size());
    auto* const geometries = const_cast<GeometryRecord*>(
        format::section<GeometryRecord>(copy.arena.data(), format::Section::geometries));
    geometries[1].positions = geometries[0].positions;
    geometries[1].texcoords[1] = geometries[1].texcoords[0];
    geometries[0].texcoords[1] = geometries[0].texcoords[0];
    const auto opened = Snapshot::open(std::move(copy));
    REQUIRE(!opened);
    CHECK(opened.error().message.find("runs of attributes overlap") != std::string::npos);
}
