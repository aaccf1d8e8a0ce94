// A scene that uses every section of an arena, for tests that damage it.
#pragma once

#include "engine/scene/motion/motion.h"
#include "tests/unit/engine/small_scenes.h"

#include <cstdint>
#include <memory>
#include <vector>

namespace raynest::test {

/// Returns an animation of "third", of the first camera and light, and of the vertices of "lone",
/// which are `corners`: a target and a joint move them.
inline MotionTables rich_motion(const std::vector<Vec3>& corners) {
    MotionTables motion;
    const auto add = [&](std::vector<float> floats) {
        const auto first = static_cast<std::uint32_t>(motion.floats.size());
        motion.floats.insert(motion.floats.end(), floats.begin(), floats.end());
        return first;
    };
    const auto count = static_cast<std::uint32_t>(corners.size());
    const std::uint32_t times = add({0, 1});
    motion.nodes.resize(2);
    motion.nodes[0].has_trs = 1;
    motion.nodes[1].parent = 0;
    motion.instances.push_back({3, 1});
    motion.cameras.push_back({0, 0});
    motion.lights.push_back({0, 0});
    motion.joints.push_back({0});
    motion.places.push_back(2);
    MovedPart part;
    part.vertices = count;
    part.positions = static_cast<std::uint32_t>(motion.floats.size());
    for (const Vec3& corner : corners) add({corner.x, corner.y, corner.z});
    part.normals = add(std::vector<float>(3 * corners.size(), 1));
    part.tangents = add(std::vector<float>(4 * corners.size(), 1));
    part.influences = 4;
    part.first_influence = add(std::vector<float>(4 * corners.size(), 0.25F));
    motion.joint_numbers.resize(4 * corners.size());
    motion.parts.push_back(part);
    const std::uint32_t differences = add(std::vector<float>(3 * corners.size(), 0.5F));
    motion.targets.push_back({differences, differences, differences});
    MovedMesh mesh;
    mesh.place_count = mesh.part_count = mesh.joint_count = mesh.weight_count = 1;
    mesh.first_weight = add({0});
    motion.meshes.push_back(mesh);
    motion.samplers = {{times, 2, add({0, 0, 0, 0, 3, 0}), 3, Interpolation::linear},
                       {times, 2, add({0, 0, 0, 1, 0, 1, 0, 0}), 4, Interpolation::step},
                       {times, 2, add({0, 0, 0, 0, 1, 0}), 1, Interpolation::cubic}};
    motion.channels = {
        {0, 0, MotionPath::translation}, {1, 0, MotionPath::rotation}, {2, 0, MotionPath::weights}};
    motion.animations.push_back({0, 0, 3, 1});
    motion.names = {'s', 'w', 'a', 'y', '\0'};
    return motion;
}

/// Returns a scene with some of everything: triangles in trees of several nodes, textures, cameras,
/// names, and records, which no built-in kernel knows.
inline std::shared_ptr<const Snapshot> rich_scene(bool has_records = true) {
    SceneDescription scene = tree_scene();
    GeometryDescription& many = scene.objects[0].geometries[0];
    for (std::uint32_t i = 0; i < 140; ++i) {
        const auto base = static_cast<std::uint32_t>(many.positions.size());
        const auto x = static_cast<float>(i % 8), y = static_cast<float>(i / 8);
        for (const Vec3& p : unit_square().positions) many.positions.push_back(p + Vec3(x, y, x));
        for (const std::uint32_t index : {0U, 1U, 2U}) many.indices.push_back(base + index);
    }
    many.texcoords[0].resize(many.positions.size());
    many.colours.resize(4 * many.positions.size());
    many.normals.resize(many.positions.size());
    many.tangents.resize(many.positions.size());
    many.material = 0;
    scene.materials.resize(2);
    scene.materials[0].texture = 0;
    scene.materials[0].alpha_mode = AlphaMode::mask;
    scene.images = {{3, 2, std::vector<std::uint8_t>(24, 100)}};
    scene.textures = {{0, Wrap::repeat, Wrap::clamp, true},
                      {0, Wrap::repeat, Wrap::clamp, false, true, false}};
    scene.materials[0].surface.use(TextureSlot::normal).texture = 1;
    scene.materials[1].surface.use(TextureSlot::emission).texture = 0;
    scene.materials[1].surface.emission = Vec3(1);
    scene.lights.resize(1);
    scene.lights[0].name = "lamp";
    scene.cameras = {{"eye", translation(0, 0, 5), 0.7F, 1}};
    MotionTables motion = rich_motion(many.positions);
    scene.motion = motion_bytes(motion);
    scene.skipped = {{"points", 1}};
    scene.warnings = {"a warning"};
    if (!has_records) return build_scene(scene);
    scene.objects.resize(4);
    ObjectDescription& marbles = scene.objects[3];
    marbles.record_type = "marble";
    for (int i = 0; i < 20; ++i) {
        const Vec3 at(static_cast<float>(i * 7 % 20), 0, 0);
        marbles.record_bounds.push_back({at, at + Vec3(1)});
    }
    marbles.records.resize(20 * 8);
    scene.objects[2].instances.push_back(place(3, Transform{}, "bag"));
    return build_scene(scene);
}

}  // namespace raynest::test
