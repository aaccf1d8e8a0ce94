// Whole compressed files: read if the build has the library, else refused by name.
#include "engine/assets/gltf/file/compressed.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/describe.h"

using namespace raynest;
using test::contains;

namespace {

/// True if this build decodes an extension; prints a message if not.
bool decodes(const char* extension) {
    const gltf::Decoder* const decoder = gltf::find_decoder(extension);
    REQUIRE(decoder != nullptr);
    const auto available = decoder->available();
    if (available) return true;
    MESSAGE("skipped: ", available.error().message);
    const auto message = test::refusal(
        test::to_bytes(std::string(R"({"asset":{"version":"2.0"},"extensionsRequired":[")") +
                       extension + "\"]}"),
        "scene.gltf");
    CHECK(contains(message, extension));
    CHECK(contains(message, "build RayNest again"));
    return false;
}

void check_box(const std::string& name, float side) {
    const auto scene = test::must_describe_shared(name);
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.indices.size() == 36);
    CHECK(geometry.positions.size() == 24);
    const Transform& place = scene.objects[scene.root].instances[0].transform;
    for (const Vec3& position : geometry.positions) {
        const Vec3 p = place.point(position);
        for (const float x : {p.x, p.y, p.z})
            CHECK(std::abs(x) == doctest::Approx(side / 2).epsilon(1e-3));
    }
    CHECK(Snapshot::build(scene).has_value());
}

}  // namespace

TEST_CASE("a box compressed with Draco has its twelve triangles") {
    if (!decodes("KHR_draco_mesh_compression") || !test::have_shared_scenes()) return;
    check_box("odd/box_draco.gltf", 1);
}

TEST_CASE("a box compressed with meshopt has its twelve triangles") {
    if (!decodes("EXT_meshopt_compression") || !test::have_shared_scenes()) return;
    check_box("odd/box_meshopt.glb", 1);
}

TEST_CASE("data that is named Draco but is not is refused as Draco") {
    if (!decodes("KHR_draco_mesh_compression") || !test::have_shared_scenes()) return;
    const test::Upload upload(test::shared_scene("odd/draco_without_bufferview.gltf"));
    const auto scene = describe_gltf(upload.request(), ImportLimits{});
    REQUIRE_FALSE(scene.has_value());
    CHECK(contains(scene.error().message, "Draco"));
}
