#include "engine/bvh/node.h"
#include "engine/geometry/triangle.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

#include <limits>

using namespace raynest;
using test::build_scene;
using test::place;
using test::rotation;
using test::scaling;
using test::translation;
using test::tree_scene;
using test::unit_square;

namespace {

/// Returns a chain of `levels` objects, each placing the next; the last holds a square.
SceneDescription chain(std::uint32_t levels, const Transform& step) {
    SceneDescription scene;
    scene.objects.resize(levels);
    for (std::uint32_t i = 0; i + 1 < levels; ++i)
        scene.objects[i].instances = {place(i + 1, step)};
    scene.objects[levels - 1].geometries = {unit_square()};
    return scene;
}

Error error_of(const SceneDescription& scene) {
    const auto snapshot = Snapshot::build(scene);
    REQUIRE_FALSE(snapshot.has_value());
    return snapshot.error();
}

bool mentions(const Error& error, const std::string& text) {
    return error.message.find(text) != std::string::npos;
}

}  // namespace

TEST_CASE("statistics count the parts that are traced") {
    const auto scene = build_scene(tree_scene());
    const SceneStatistics& s = scene->statistics();
    CHECK(s.unique_triangles == 4);
    CHECK(s.instances == 10);  // three twigs of three squares and one leaf
    CHECK(s.instanced_triangles == 20);
    CHECK(s.levels == 3);
    CHECK(s.skipped.empty());
    CHECK(s.bytes == scene->bytes().size());
}

TEST_CASE("a scene whose root holds the triangles is one instance") {
    SceneDescription description;
    description.objects.resize(1);
    description.objects[0].geometries = {unit_square()};
    const auto scene = build_scene(description);
    CHECK(scene->statistics().instances == 1);
    CHECK(scene->statistics().levels == 1);
    CHECK(scene->bounds().upper == Vec3(1, 1, 0));
}

TEST_CASE("instances keep their declaration order and know the number of leaves before them") {
    const auto scene = build_scene(tree_scene());
    const SceneView& view = scene->view();
    const ObjectRecord& root = view.objects[view.root];
    REQUIRE(root.instance_count == 4);
    const std::uint64_t expected[] = {0, 3, 6, 7};
    const std::uint32_t uids[] = {1, 2, 3, 4};
    for (std::uint32_t i = 0; i < 4; ++i) {
        CHECK(view.instances[root.first_instance + i].path_base == expected[i]);
        CHECK(view.instance_infos[root.first_instance + i].uid == uids[i]);
    }
    CHECK(root.placement_count == 10);
    const ObjectRecord& twig = view.objects[view.instances[root.first_instance].object];
    CHECK(view.instances[twig.first_instance].path_base == 1);  // own triangles take slot 0
}

TEST_CASE("leaf blocks hold the exact vertices, padding lanes none") {
    const auto scene = build_scene(tree_scene());
    const SceneView& view = scene->view();
    std::uint64_t triangles = 0;
    for (std::uint64_t b = 0; b < scene->statistics().leaf_blocks; ++b) {
        for (std::size_t lane = 0; lane < 8; ++lane) {
            const TriangleBlock& block = view.blocks[b];
            const bool second = block.triangle[lane] == 1;
            if (block.triangle[lane] == no_id) {
                for (int axis = 0; axis < 3; ++axis) CHECK(block.vertex[1][axis][lane] == 0);
                continue;
            }
            ++triangles;
            CHECK(block.vertex[1][0][lane] == 1);
            CHECK(block.vertex[1][1][lane] == (second ? 1 : 0));
        }
    }
    CHECK(triangles == 4);
}

TEST_CASE("leaf blocks of masked triangles have their texture coordinates beside them") {
    SceneDescription description;
    description.images = {{1, 1, {0, 0, 0, 0}}};
    description.textures = {{0, Wrap::repeat, Wrap::repeat, true}};
    description.materials.resize(3);
    for (MaterialDescription& material : description.materials) material.texture = 0;
    description.materials[0].alpha_mode = AlphaMode::mask;
    description.materials[1].alpha_mode = AlphaMode::blend;
    description.materials[1].texcoord = 1;  // which the square lacks
    description.objects.resize(2);
    description.objects[0].geometries = {unit_square(0), unit_square(1), unit_square(2)};
    description.objects[0].instances = {place(1, translation(0, 0, 1))};
    description.objects[1].geometries = {unit_square(2)};
    const auto scene = build_scene(description);
    const SceneView& view = scene->view();

    const ObjectRecord& masked = view.objects[view.root];
    REQUIRE(masked.block_count == 1);
    const std::vector<Vec2> expected[] = {
        {{0, 0}, {1, 0}, {1, 1}}, {{0, 0}, {1, 1}, {0, 1}},  // its own
        {{0, 0}, {0, 0}, {0, 0}}, {{0, 0}, {0, 0}, {0, 0}},  // a texture that is not looked up
        {{0, 0}, {0, 0}, {0, 0}}, {{0, 0}, {0, 0}, {0, 0}}};
    const TriangleBlock& block = view.blocks[masked.first_block];
    const auto& corners = view.attribute<TexcoordBlock>(masked.texcoord_blocks)->corner;
    for (std::size_t lane = 0; lane < 8; ++lane) {
        if (block.triangle[lane] == no_id) continue;
        const std::vector<Vec2> found(std::begin(corners[lane]), std::end(corners[lane]));
        CHECK(found == expected[block.triangle[lane]]);
    }
    CHECK(view.objects[view.instances[masked.first_instance].object].texcoord_blocks == no_offset);
}

TEST_CASE("a singular instance is left out and counted with all that it places") {
    SceneDescription description = tree_scene();
    description.objects[2].instances[1].transform = scaling(1, 0, 1);
    const auto scene = build_scene(description);
    const SceneStatistics& s = scene->statistics();
    CHECK(s.instances == 7);
    CHECK(s.instanced_triangles == 14);
    CHECK(s.skipped.at("singular_instances") == 3);
    CHECK(s.skipped.at("singular_instance_triangles") == 6);
    CHECK(s.skipped.count("singular_unique_triangles") == 0);  // other twigs remain
    CHECK(scene->view().objects[scene->view().root].instance_count == 3);
    REQUIRE(s.warnings.size() == 1);
    CHECK(s.warnings[0].starts_with("3 placements are left out"));

    description.objects[2].instances[1].transform = Transform{};
    description.objects[2].instances[2].transform = scaling(1, 0, 1);
    CHECK(build_scene(description)
              ->statistics()
              .warnings.at(0)
              .starts_with("1 placement is left out"));
}

TEST_CASE("a scene of which most triangles have no area says so before all else") {
    SceneDescription description;
    description.warnings = {"something small"};
    description.objects.resize(1);
    GeometryDescription square = unit_square();
    const auto built = [&] {
        description.objects[0].geometries = {square};
        return build_scene(description);
    };
    square.indices.insert(square.indices.end(), {0, 0, 1, 2, 2, 2});
    CHECK(built()->statistics().warnings == description.warnings);  // one half is not most
    square.indices.insert(square.indices.end(), {1, 1, 1});
    const auto scene = built();
    CHECK(scene->statistics().degenerate_triangles == 3);
    REQUIRE(scene->statistics().warnings.size() == 2);
    CHECK(scene->statistics().warnings[0].starts_with("3 of 5 triangles have no area"));
    square.indices = {1, 1, 1};
    CHECK(built()->statistics().warnings[0].starts_with("1 of 1 triangles has no area"));
}

TEST_CASE("what only a singular instance reaches is not stored") {
    SceneDescription description;
    description.objects.resize(2);
    description.objects[0].instances = {place(1, scaling(0, 0, 0))};
    description.objects[1].geometries = {unit_square()};
    const auto scene = build_scene(description);
    CHECK(scene->statistics().unique_triangles == 0);
    CHECK(scene->statistics().skipped.at("singular_unique_triangles") == 2);
    CHECK(scene->statistics().instances == 0);
    CHECK(scene->view().object_count == 1);
    CHECK(scene->bounds().is_empty());
}

TEST_CASE("32 levels are built, 33 are refused by name") {
    CHECK(build_scene(chain(32, rotation(0.1F)))->statistics().levels == 32);
    SceneDescription deep = chain(33, rotation(0.1F));
    deep.objects[0].name = "tower";
    const Error error = error_of(deep);
    CHECK(error.code == ErrorCode::limit_exceeded);
    CHECK(mentions(error, "'tower'"));
}

TEST_CASE("a long chain of objects exhausts no stack") {
    const Error error = error_of(chain(200'000, Transform{}));
    CHECK(error.code == ErrorCode::limit_exceeded);
}

TEST_CASE("cycles are refused by name") {
    SceneDescription scene = tree_scene();
    scene.objects[0].instances = {place(1, Transform{})};
    CHECK(mentions(error_of(scene), "contains itself"));
    SceneDescription self = tree_scene();
    self.objects[2].instances.push_back(place(2, Transform{}));
    CHECK(mentions(error_of(self), "'root'"));
}

TEST_CASE("more than 2^63 paths are refused") {
    SceneDescription scene = chain(31, Transform{});
    for (std::uint32_t i = 0; i + 1 < 31; ++i) {
        scene.objects[i].instances.resize(8, place(i + 1, Transform{}));
    }
    CHECK(error_of(scene).code == ErrorCode::limit_exceeded);
}

TEST_CASE("coordinates that no tree can hold are refused with their count") {
    for (const float bad : {2e15F, -std::numeric_limits<float>::infinity(),
                            std::numeric_limits<float>::quiet_NaN()}) {
        SceneDescription scene = tree_scene();
        scene.objects[0].geometries[0].positions[1].y = bad;  // only of the first triangle
        const Error error = error_of(scene);
        CHECK(error.code == ErrorCode::scene_invalid);
        CHECK(mentions(error, "'leaf' has 1 primitives"));
    }
    SceneDescription far = tree_scene();
    far.objects[2].instances[0].transform = scaling(1e16F, 1, 1);
    CHECK(mentions(error_of(far), "instance 0 ('first') of object 'root' reaches beyond 1e15"));
}

TEST_CASE("inconsistent descriptions are refused") {
    const auto refused = [](auto&& spoil) {
        SceneDescription scene = tree_scene();
        scene.materials.resize(1);
        scene.textures.resize(1);
        scene.textures[0].image = 0;
        scene.images = {{1, 1, {1, 2, 3, 4}}};
        REQUIRE(Snapshot::build(scene).has_value());
        spoil(scene);
        return error_of(scene).code == ErrorCode::scene_invalid;
    };
    using S = SceneDescription&;
    CHECK(refused([](S s) { s.root = 3; }));
    CHECK(refused([](S s) { s.objects[2].instances[0].object = 7; }));
    CHECK(refused([](S s) { s.objects[0].geometries[0].indices[0] = 4; }));
    CHECK(refused([](S s) { s.objects[0].geometries[0].indices.pop_back(); }));
    CHECK(refused([](S s) { s.objects[0].geometries[0].texcoords[0].pop_back(); }));
    CHECK(refused([](S s) { s.objects[0].geometries[0].colours.resize(15); }));
    CHECK(refused([](S s) { s.objects[0].geometries[0].material = 1; }));
    CHECK(refused([](S s) { s.materials[0].texture = 1; }));
    CHECK(refused([](S s) { s.materials[0].texcoord = 2; }));
    CHECK(refused([](S s) { s.materials[0].cutoff = std::numeric_limits<float>::infinity(); }));
    CHECK(refused([](S s) { s.materials[0].alpha_mode = static_cast<AlphaMode>(3); }));
    CHECK(refused([](S s) { s.textures[0].image = no_id; }));
    CHECK(refused([](S s) { s.textures[0].wrap_t = static_cast<Wrap>(3); }));
    CHECK(refused([](S s) { s.images[0].rgba.pop_back(); }));
    CHECK(refused([](S s) { s.images[0].width = 0; }));
    CHECK(refused([](S s) { s.cameras.resize(1), s.cameras[0].yfov = 0; }));
    CHECK(refused([](S s) { s.objects[0].records.resize(4); }));
    CHECK(refused([](S s) {
        s.objects[2].record_type = "sphere";
        s.objects[2].records.resize(7);
        s.objects[2].record_bounds.resize(2, {Vec3(0), Vec3(1)});
    }));
    CHECK(refused([](S s) {
        s.objects[0].record_type = "sphere";
        s.objects[0].records.resize(16);
        s.objects[0].record_bounds = {{Vec3(0), Vec3(1)}};
    }));
}

TEST_CASE("records are reordered by the tree and found by their original index") {
    SceneDescription description;
    description.objects.resize(1);
    ObjectDescription& object = description.objects[0];
    object.record_type = "marble";
    constexpr std::uint32_t count = 100;
    constexpr std::uint32_t size = 6;  // not a multiple of four
    for (std::uint32_t i = 0; i < count; ++i) {
        const auto x = static_cast<float>(i * 37 % count);
        object.record_bounds.push_back({Vec3(x, 0, 0), Vec3(x + 1, 1, 1)});
        for (std::uint32_t b = 0; b < size; ++b)
            object.records.push_back(static_cast<std::byte>(i));
    }
    const auto scene = build_scene(description);
    const SceneView& view = scene->view();
    const ObjectRecord& record = view.objects[0];
    CHECK(record.record_type == primitive_type("marble"));
    CHECK(scene->record_types() == std::vector<std::string>{"marble"});
    bool reordered = false;
    for (std::uint32_t i = 0; i < count; ++i) {
        const std::byte* found = view.record_of(record, i);
        CHECK(found[0] == static_cast<std::byte>(i));
        CHECK(found[size - 1] == static_cast<std::byte>(i));
        reordered = reordered || found != view.records + i * record_stride(size);
    }
    CHECK(reordered);
}

TEST_CASE("textures of one image share its planes") {
    SceneDescription description = tree_scene();
    description.images = {{1, 2, {10, 20, 30, 40, 50, 60, 70, 80}}};
    description.textures = {{0, Wrap::repeat, Wrap::clamp, false},
                            {0, Wrap::mirror, Wrap::repeat, true}};
    const auto scene = build_scene(description);
    const SceneView& view = scene->view();
    REQUIRE(view.texture_count == 2);
    CHECK(view.textures[0].colour == view.textures[1].colour);
    CHECK(view.textures[0].alpha == view.textures[1].alpha);
    const auto* alpha = view.attribute<std::uint8_t>(view.textures[0].alpha);
    CHECK(alpha[0] == 40);
    CHECK(alpha[1] == 80);
    CHECK(view.attribute<std::uint8_t>(view.textures[0].colour)[4] == 50);
    CHECK(view.textures[1].nearest == 1);
    CHECK(view.textures[1].wrap_s == Wrap::mirror);
}

TEST_CASE("camera poses lose the scale of their node") {
    SceneDescription description = tree_scene();
    const Transform pose = compose(translation(1, 2, 3), rotation(0.5F));
    description.cameras = {{"big", compose(pose, scaling(4, 2, 7)), 0.7F, 1.5F},
                           {"flat", scaling(0, 0, 0), 0.7F, 0}};
    const auto scene = build_scene(description);
    const CameraRecord& big = scene->view().cameras[0];
    for (std::size_t i = 0; i < 12; ++i) {
        CHECK(big.to_world.m[i] == doctest::Approx(pose.m[i]).epsilon(1e-6));
    }
    CHECK(scene->view().cameras[1].to_world == Transform{});
    CHECK(scene->statistics().cameras == std::vector<std::string>{"big", "flat"});
}

TEST_CASE("rounding errors of nested rotations add up, they do not multiply") {
    const auto nested = build_scene(chain(32, rotation(0.1F)));
    const float error = nested->view().objects[nested->view().root].origin_error;
    CHECK(error > 31);
    CHECK(error < 34);
    const auto stretched = build_scene(chain(2, scaling(1, 1, 50)));
    CHECK(stretched->view().objects[1].origin_error == doctest::Approx(100));
    CHECK(nested->view().objects[0].origin_error == 1);
}

TEST_CASE("the box of an instance holds its corners with room for rounding") {
    const Transform step = compose(translation(1000, -500, 3), rotation(0.3F));
    const auto scene = build_scene(chain(2, step));
    const Box& bounds = scene->view().objects[scene->view().root].bounds;
    const float ulp = 1000 * 0x1p-23F;
    for (const Vec3& corner : unit_square().positions) {
        const Vec3 p = step.point(corner);
        for (int axis = 0; axis < 3; ++axis) {
            CHECK(bounds.lower[axis] < p[axis] - ulp);
            CHECK(bounds.upper[axis] > p[axis] + ulp);
        }
    }
    CHECK(bounds.size().x < 1.01F);  // and hardly more than that
}

TEST_CASE("equal descriptions give equal bytes, and others another digest") {
    const auto first = build_scene(tree_scene());
    const auto second = build_scene(tree_scene());
    CHECK(first->digest() == second->digest());
    CHECK(first->digest().size() == 64);
    SceneDescription other = tree_scene();
    other.objects[2].instances[3].uid = 5;
    CHECK(build_scene(other)->digest() != first->digest());
}

TEST_CASE("skips, warnings and names survive the arena") {
    SceneDescription description = tree_scene();
    description.skipped = {{"points", 3}};
    description.warnings = {"mesh 'a' has a skin: shown as stored"};
    const auto scene = build_scene(description);
    CHECK(scene->statistics().skipped.at("points") == 3);
    CHECK(scene->statistics().warnings == description.warnings);
}
