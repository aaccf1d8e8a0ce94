// Scenes of a few triangles that several tests share.
#pragma once

#include "engine/scene/snapshot.h"

#include <cmath>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

namespace raynest::test {

inline Transform translation(float x, float y, float z) {
    return {{1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z}};
}

inline Transform scaling(float x, float y, float z) {
    return {{x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, 0}};
}

/// Returns a rotation about the y axis, in radians.
inline Transform rotation(float angle) {
    const float c = std::cos(angle), s = std::sin(angle);
    return {{c, 0, s, 0, 0, 1, 0, 0, -s, 0, c, 0}};
}

/// Returns the unit square in the xy plane, two triangles, normal +z, texture coordinates = (x, y).
inline GeometryDescription unit_square(std::uint32_t material = no_id) {
    GeometryDescription square;
    square.positions = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    square.indices = {0, 1, 2, 0, 2, 3};
    square.texcoords[0] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    square.material = material;
    return square;
}

inline InstanceDescription place(std::uint32_t object, const Transform& transform,
                                 std::string name = "", std::uint32_t uid = 0) {
    return {object, transform, 0xFFFFFFFFU, uid, std::move(name)};
}

/// Builds a scene; throws the error's message.
inline std::shared_ptr<const Snapshot> build_scene(const SceneDescription& description) {
    auto snapshot = Snapshot::build(description);
    if (!snapshot) throw std::runtime_error(snapshot.error().message);
    return *snapshot;
}

/// Returns a scene of one square with sides of this length.
inline std::shared_ptr<const Snapshot> square(float size) {
    SceneDescription scene;
    scene.objects.resize(1);
    scene.objects[0].geometries = {unit_square()};
    for (Vec3& p : scene.objects[0].geometries[0].positions) p *= size;
    return build_scene(scene);
}

/// Returns objects: 0 "leaf" (a square), 1 "twig" (its own square and two leaves), 2 "root" (three
/// twigs and a leaf). Paths: twig = 3, root = 10.
inline SceneDescription tree_scene() {
    SceneDescription scene;
    scene.objects.resize(3);
    scene.objects[0].name = "leaf";
    scene.objects[0].geometries = {unit_square()};
    scene.objects[1].name = "twig";
    scene.objects[1].geometries = {unit_square()};
    scene.objects[1].instances = {place(0, translation(0, 2, 0), "low", 11),
                                  place(0, translation(0, 4, 0), "", 12)};
    scene.objects[2].name = "root";
    scene.objects[2].instances = {
        place(1, translation(0, 0, 0), "first", 1), place(1, translation(10, 0, 0), "second", 2),
        place(0, translation(20, 0, 0), "lone", 3), place(1, rotation(1), "third", 4)};
    scene.root = 2;
    return scene;
}

}  // namespace raynest::test
