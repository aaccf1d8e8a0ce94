// Regression tests for faults of the glTF reader: each test fails with one of them.
#include "tests/unit/engine/assets/describe.h"

using namespace raynest;
using test::contains;
using test::GlbWriter;
using test::must_describe;
using test::one_triangle_mesh;
using test::refusal;

namespace {

/// Checks a quarter turn about z after scales of 1, 2 and 3, by column: (0,1,0), (-2,0,0), (0,0,3).
void check_turned_and_scaled(const Transform& transform) {
    const std::array<float, 12> expected{0, -2, 0, 7, 1, 0, 0, 8, 0, 0, 3, 9};
    for (std::size_t i = 0; i < 12; ++i) {
        CAPTURE(i);
        CHECK(transform.m[i] == doctest::Approx(expected[i]).epsilon(1e-6));
    }
}

}  // namespace

TEST_CASE("attributes of the application place nothing, but tell how many placements there are") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const int two = writer.add_floats({7, 8}, "SCALAR", 1);
    const int three = writer.add_floats({7, 8, 9}, "SCALAR", 1);
    const int places = writer.add_floats({1, 0, 0, 2, 0, 0, 3, 0, 0}, "VEC3", 3);
    const auto glb = [&](const std::string& attributes) {
        return writer.glb(mesh +
                          R"(,"extensionsRequired":["EXT_mesh_gpu_instancing"],"nodes":[{"mesh":0,
            "extensions":{"EXT_mesh_gpu_instancing":{"attributes":{)" +
                          attributes + "}}}}]");
    };
    const std::string id2 = "\"_ID\":" + std::to_string(two);
    const auto scene = must_describe(glb(id2));
    const auto& instances = scene.objects[scene.root].instances;
    REQUIRE(instances.size() == 2);
    for (const InstanceDescription& instance : instances)
        CHECK(instance.transform.point({1, 2, 3}) == Vec3(1, 2, 3));
    // Where something places instances, attributes of the application are not looked at.
    const auto placed = must_describe(glb("\"TRANSLATION\":" + std::to_string(places) + "," + id2));
    CHECK(placed.objects[placed.root].instances.size() == 3);
    CHECK(contains(refusal(glb(id2 + ",\"_AGE\":" + std::to_string(three))),
                   "elements where others have"));
    CHECK(contains(refusal(glb("\"_ID\":99")), "accessor"));
    CHECK(contains(refusal(glb("\"_ID\":\"x\"")), "_ID names no accessor"));
    CHECK(contains(refusal(glb("\"ID\":" + std::to_string(two))), "without a placement"));
}

TEST_CASE("a node is scaled before it is turned, and an instance of EXT_mesh_gpu_instancing too") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const float half = 0.70710678F;
    const int translation = writer.add_floats({7, 8, 9}, "VEC3", 3);
    const int rotation = writer.add_floats({0, 0, half, half}, "VEC4", 4);
    const int scale = writer.add_floats({1, 2, 3}, "VEC3", 3);
    const auto scene = must_describe(writer.glb(mesh + R"(,"nodes":[{"mesh":0,"translation":[7,8,9],
        "rotation":[0,0,0.7071067811865476,0.7071067811865476],"scale":[1,2,3]},
        {"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":)" +
                                                std::to_string(translation) +
                                                ",\"ROTATION\":" + std::to_string(rotation) +
                                                ",\"SCALE\":" + std::to_string(scale) + "}}}}]"));
    const auto& instances = scene.objects[scene.root].instances;
    REQUIRE(instances.size() == 2);
    check_turned_and_scaled(instances[0].transform);
    check_turned_and_scaled(instances[1].transform);
}

TEST_CASE("interleaved attributes are read by their stride") {
    // {x, y, z, u, v} per vertex, 20 bytes apart.
    const std::vector<float> vertices = {0,    0,    0, 0.1F, 0.2F, 5,    0,   0,
                                         0.3F, 0.4F, 0, 6,    7,    0.5F, 0.6F};
    std::string binary(vertices.size() * sizeof(float), '\0');
    std::memcpy(binary.data(), vertices.data(), binary.size());
    std::string json = R"({"asset":{"version":"2.0"},"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1}}]}],
        "buffers":[{"byteLength":60,"uri":"v.bin"}],
        "bufferViews":[{"buffer":0,"byteLength":60,"byteStride":20}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
        {"bufferView":0,"byteOffset":12,"componentType":5126,"count":3,"type":"VEC2"}]})";
    test::Upload upload("scene.gltf", test::to_bytes(json));
    upload.add("v.bin", test::to_bytes(binary));
    const auto scene = must_describe(describe_gltf(upload.request(), ImportLimits{}));
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.positions == std::vector<Vec3>{{0, 0, 0}, {5, 0, 0}, {0, 6, 7}});
    CHECK(geometry.texcoords[0] == std::vector<Vec2>{{0.1F, 0.2F}, {0.3F, 0.4F}, {0.5F, 0.6F}});
}

TEST_CASE("a matrix that is not affine is refused") {
    const auto complaint = [](const std::string& last) {
        const std::string json =
            R"({"asset":{"version":"2.0"},"nodes":[{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,)" +
            last + "]}]}";
        const test::Upload upload("scene.gltf", test::to_bytes(json));
        const auto scene = describe_gltf(upload.request(), ImportLimits{});
        return scene ? std::string() : scene.error().message;
    };
    CHECK(!contains(complaint("1"), "projective"));
    CHECK(contains(complaint("0"), "projective"));
    CHECK(contains(complaint("2"), "projective"));
}

TEST_CASE("the alpha of COLOR_0 is kept") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    writer.add<std::uint8_t>({10, 20, 30, 0, 40, 50, 60, 128, 70, 80, 90, 255}, "VEC4", 5121, 4,
                             ",\"normalized\":true");
    const auto scene = must_describe(writer.glb(
        R"("meshes":[{"primitives":[{"attributes":{"POSITION":0,"COLOR_0":1}}]}],"nodes":[{"mesh":0}])"));
    CHECK(scene.objects[0].geometries[0].colours ==
          std::vector<std::uint8_t>{56, 79, 96, 0, 110, 122, 133, 128, 143, 152, 160, 255});
}
