// Scenes at moments of their animations: which tables are refused, and what edits leave of them.
#include "engine/scene/edits/pose.h"

#include "engine/scene/edits/edit.h"
#include "tests/unit/engine/rich_scene.h"

#include <doctest/doctest.h>

#include <functional>
#include <limits>

using namespace raynest;

namespace {

constexpr std::uint32_t outermost = 4;
constexpr std::uint32_t cameras = 1;
constexpr std::uint32_t lights = 1;

bool is_read(MotionTables tables) {
    return read_motion(motion_bytes(tables), outermost, cameras, lights).has_value();
}

MotionTables good_tables() {
    return test::rich_motion(test::unit_square().positions);
}

}  // namespace

TEST_CASE("motion tables are refused for each index, length and number that is wrong") {
    REQUIRE(is_read(good_tables()));
    using Damage = std::function<void(MotionTables&)>;
    const std::vector<Damage> damages = {
        [](MotionTables& m) { m.animations[0].channel_count = 4; },
        [](MotionTables& m) { m.animations[0].name = 5; },
        [](MotionTables& m) { m.animations[0].seconds = -1; },
        [](MotionTables& m) { m.animations[0].seconds = 2 * motion_seconds_max; },
        [](MotionTables& m) { m.animations.resize(motion_animations_max + 1); },
        [](MotionTables& m) { m.channels[0].target = 2; },
        [](MotionTables& m) { m.channels[0].target = 1; },  // it has no parts
        [](MotionTables& m) { m.channels[0].path = MotionPath::rotation; },
        [](MotionTables& m) { m.channels[2].target = 1; },
        [](MotionTables& m) { m.channels[1].sampler = 3; },
        [](MotionTables& m) { m.samplers[0].keys = 0; },
        [](MotionTables& m) { m.samplers[0].first_value = no_id; },
        [](MotionTables& m) { m.samplers[2].interpolation = static_cast<Interpolation>(3); },
        [](MotionTables& m) { m.floats[1] = 0; },  // the second key is not behind the first
        [](MotionTables& m) { m.floats[0] = -1; },
        [](MotionTables& m) { m.floats[7] = std::numeric_limits<float>::infinity(); },
        [](MotionTables& m) { m.nodes[1].parent = 1; },
        [](MotionTables& m) { m.nodes[0].trs[3] = std::numeric_limits<double>::quiet_NaN(); },
        [](MotionTables& m) { m.instances[0].outermost = outermost; },
        [](MotionTables& m) { m.instances[0].node = 2; },
        [](MotionTables& m) { m.cameras[0].camera = cameras; },
        [](MotionTables& m) { m.lights[0].light = lights; },
        [](MotionTables& m) { m.lights[0].node = 2; },
        [](MotionTables& m) { m.joints[0].node = 2; },
        [](MotionTables& m) { m.places[0] = outermost; },
        [](MotionTables& m) { m.meshes[0].place_count = 2; },
        [](MotionTables& m) { m.meshes[0].joint_count = 2; },
        [](MotionTables& m) { m.meshes[0].part_count = 2; },
        [](MotionTables& m) { m.meshes[0].weight_count = 2; },
        [](MotionTables& m) { m.parts[0].vertices = no_id; },
        [](MotionTables& m) { m.parts[0].normals = no_id - 1; },
        [](MotionTables& m) { m.parts[0].influences = 3; },
        [](MotionTables& m) { m.joint_numbers[0] = 1; },
        [](MotionTables& m) { m.targets[0].positions = no_id - 1; },
        [](MotionTables& m) { m.names.pop_back(); },
    };
    for (std::size_t i = 0; i < damages.size(); ++i) {
        MotionTables tables = good_tables();
        damages[i](tables);
        CHECK_MESSAGE(!is_read(std::move(tables)), "damage ", i);
    }
    MotionTables tables = good_tables();
    std::vector<std::byte> bytes = motion_bytes(tables);
    bytes.pop_back();
    CHECK(!read_motion(bytes, outermost, cameras, lights));
    CHECK(read_motion({}, outermost, cameras, lights)->animations.empty());
}

TEST_CASE("instances that an edit removes take no others' motion with them") {
    const auto scene = test::rich_scene(false);
    SceneChanges changes;
    changes.removed = {0};
    const auto edited = edit_scene(*scene, changes);
    REQUIRE_MESSAGE(edited.has_value(), (edited ? "" : edited.error().message));
    const Motion motion = checked_motion((*edited)->motion_bytes());
    REQUIRE(motion.instances.size() == 1);
    CHECK(motion.instances[0].outermost == 2);  // 3 before
    REQUIRE(motion.places.size() == 1);
    CHECK(motion.places[0] == 1);  // 2 before
    changes.removed = {2};
    const auto without = edit_scene(*scene, changes);
    REQUIRE(without.has_value());
    CHECK(checked_motion((*without)->motion_bytes()).meshes[0].place_count == 0);
    CHECK(pose(**without, {0, 0.5}).has_value());
}

TEST_CASE("a pose moves what its tables say, and the scene stays") {
    const auto scene = test::rich_scene(false);
    const std::string digest = scene->digest();
    const auto posed = pose(*scene, *find_moment(*scene, "sway", 0.5));
    REQUIRE_MESSAGE(posed.has_value(), (posed ? "" : posed.error().message));
    CHECK(scene->digest() == digest);
    CHECK((*posed)->digest() != digest);
    const SceneView& view = (*posed)->view();
    const InstanceInfo* const infos = view.instance_infos + view.objects[view.root].first_instance;
    CHECK(infos[3].to_parent.m[7] == 1.5F);  // half of 3
    CHECK(view.cameras[0].to_world.m[7] == 1.5F);
    CHECK((*posed)->shading().lights[0].position == Vec3(0, 1.5F, 0));
    CHECK((*posed)->shading().lights[0].direction == Vec3(0, 0, -1));
    // The cubic channel is at 0.5 of its way: half of the target's 0.5, and the joint moved by 1.5.
    const ObjectRecord& lone =
        view.objects[view.instances[view.objects[view.root].first_instance + 2].object];
    const auto* const corners =
        view.attribute<Vec3>(view.geometries[lone.first_geometry].positions);
    const Vec3 before = test::unit_square().positions[0];
    CHECK(corners[0].x == doctest::Approx(before.x + 0.25F));
    CHECK(corners[0].y == doctest::Approx(before.y + 0.25F + 1.5F));
    for (const double seconds : {-0.1, 1.1, std::numeric_limits<double>::quiet_NaN()})
        CHECK(!find_moment(*scene, "", seconds));
    for (const char* const unknown : {"run", "swa", "sway2"})
        CHECK(!find_moment(*scene, unknown, 0));
    CHECK(!find_moment(*scene, "1", 0));
    CHECK(find_moment(*scene, "0", 1).has_value());
}
