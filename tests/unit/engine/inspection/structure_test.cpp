// The facts of a scene's objects.
#include "engine/inspection/structure.h"

#include "tests/unit/engine/small_scenes.h"

#include <doctest/doctest.h>

using namespace raynest;

TEST_CASE("the bytes of an object count each attribute of its vertices") {
    const auto bytes_of = [](const GeometryDescription& square) {
        SceneDescription scene;
        scene.objects.resize(1);
        scene.objects[0].geometries = {square};
        return object_facts(*test::build_scene(scene), 0, 1).at(0).bytes;
    };
    const GeometryDescription plain = test::unit_square();
    GeometryDescription coloured = plain;
    coloured.colours.assign(4 * plain.positions.size(), 255);
    CHECK(bytes_of(coloured) == bytes_of(plain) + 4 * plain.positions.size());
}
