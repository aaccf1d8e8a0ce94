// Morph targets with the weights of the node, else of the mesh.
#include "tests/unit/engine/assets/describe.h"

using namespace raynest;
using test::contains;
using test::GlbWriter;
using test::must_describe;
using test::refusal;

namespace {

const std::vector<Vec3>& positions_of(const SceneDescription& scene, std::size_t instance) {
    const auto& shown = scene.objects[scene.root].instances.at(instance);
    return scene.objects[shown.object].geometries.at(0).positions;
}

/// Returns a triangle with accessors 1 (all vertices by +1 in x) and 2 (by +1 in y) as targets.
std::string morphed_triangle(GlbWriter& writer, const std::string& mesh_members) {
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    writer.add_floats({1, 0, 0, 1, 0, 0, 1, 0, 0}, "VEC3", 3);
    writer.add_floats({0, 1, 0, 0, 1, 0, 0, 1, 0}, "VEC3", 3);
    return R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},
           "targets":[{"POSITION":1},{"POSITION":2,"NORMAL":1}]}])" +
           mesh_members + "}]";
}

}  // namespace

TEST_CASE("morph weights are the node's, else the mesh's, else 0") {
    GlbWriter writer;
    const auto scene = must_describe(writer.glb(morphed_triangle(writer, R"(,"weights":[0.5,0])") +
                                                R"(,"nodes":[{"mesh":0},{"mesh":0,"weights":[0,2]},
                                 {"mesh":0,"weights":[0.5,0]},{"mesh":0,"weights":[0,2]}])"));
    CHECK(positions_of(scene, 0)[0] == Vec3(0.5F, 0, 0));
    CHECK(positions_of(scene, 1)[0] == Vec3(0, 2, 0));
    const auto& instances = scene.objects[scene.root].instances;
    CHECK(instances[2].object == instances[0].object);
    CHECK(instances[3].object == instances[1].object);
    CHECK(scene.warnings.empty());

    GlbWriter plain;
    const auto unmoved =
        must_describe(plain.glb(morphed_triangle(plain, "") + R"(,"nodes":[{"mesh":0}])"));
    CHECK(positions_of(unmoved, 0)[0] == Vec3(0, 0, 0));
}

TEST_CASE("the shared morph files are shown with their weights") {
    if (!test::have_shared_scenes()) return;
    const auto quad = test::must_describe_shared("odd/morph_weight_1.glb");
    for (const Vec3& p : positions_of(quad, 0)) CHECK((p.x >= 2 && p.y >= 2 && p.z == 2));
    CHECK(quad.warnings.empty());
}

TEST_CASE("targets may be sparse without a bufferView, and may change only some vertices") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    writer.add_indices({1});
    writer.add_floats({0, 0, 8}, "VEC3", 3);
    writer.add<float>({0, 0, 0, 0, 0, 0, 0, 0, 0}, "VEC3", 5126, 3,
                      R"(,"sparse":{"count":1,"indices":{"bufferView":1,"componentType":5123},
                      "values":{"bufferView":2}})");
    auto bytes = writer.glb(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},
        "targets":[{"POSITION":3}]}],"weights":[0.25]}],"nodes":[{"mesh":0}])");
    for (const bool with_view : {true, false}) {
        if (!with_view) {
            // The writer gives every accessor a bufferView: remove this one's.
            const std::string member = "\"bufferView\":3";
            const auto begin = reinterpret_cast<char*>(bytes.data());
            std::string_view text(begin, bytes.size());
            const std::size_t at = text.find(member);
            REQUIRE(at != std::string_view::npos);
            std::copy_n("\"unused\"    :3", member.size(), begin + at);
        }
        const auto scene = must_describe(bytes);
        CHECK(positions_of(scene, 0) == std::vector<Vec3>{{0, 0, 0}, {1, 0, 2}, {0, 1, 0}});
    }
}

TEST_CASE("targets also change texture coordinates and colours") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    writer.add_floats({0, 0, 1, 0, 0, 1}, "VEC2", 2);
    writer.add_floats({1, 1, 1, 0, 1, 1, 1, 0, 1, 1, 1, 0}, "VEC4", 4);
    writer.add_floats({0.5F, 0, 0.5F, 0, 0.5F, 0}, "VEC2", 2);
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 0.2F, 0, 0, 0, 9}, "VEC4", 4);
    const auto scene = must_describe(writer.glb(R"("meshes":[{"primitives":[{"attributes":{
        "POSITION":0,"TEXCOORD_0":1,"COLOR_0":2},"targets":[{"TEXCOORD_0":3,"COLOR_0":4}]}],
        "weights":[1]}],"nodes":[{"mesh":0}])"));
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.texcoords[0] == std::vector<Vec2>{{0.5F, 0}, {1.5F, 0}, {0.5F, 1}});
    CHECK(geometry.colours[3] == 255);
    CHECK(geometry.colours[7] == 51);
    CHECK(geometry.colours[11] == 255);
}

TEST_CASE("hostile morph targets are refused by name, surplus weights are ignored") {
    const auto refused = [](const std::string& mesh_members, const std::string& node_members) {
        GlbWriter writer;
        return refusal(writer.glb(morphed_triangle(writer, mesh_members) +
                                  R"(,"nodes":[{"mesh":0)" + node_members + "}]"));
    };
    CHECK(contains(refused(R"(,"weights":[1e300])", ""), "a morph weight does not fit a float"));
    CHECK(contains(refused("", R"(,"weights":[0,-1e300])"), "node 0: a morph weight"));

    for (const char* weights : {"[]", "[1]", "[1,0,5,6,7]"}) {
        GlbWriter writer;
        const auto scene = must_describe(writer.glb(
            morphed_triangle(writer, "") + R"(,"nodes":[{"mesh":0,"weights":)" + weights + "}]"));
        CHECK(positions_of(scene, 0)[0] == Vec3(weights[1] == ']' ? 0.0F : 1.0F, 0, 0));
    }

    const auto target = [](const std::vector<float>& values, const char* type, std::size_t width,
                           const std::string& index = "1") {
        GlbWriter writer;
        writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
        writer.add_floats(values, type, width);
        return refusal(writer.glb(R"("meshes":[{"weights":[1],"primitives":[{"attributes":
            {"POSITION":0},"targets":[{"POSITION":)" +
                                  index + R"(}]}]}],"nodes":[{"mesh":0}])"));
    };
    CHECK(contains(target({1, 1, 1, 1, 1, 1}, "VEC3", 3), "2 elements of POSITION"));
    CHECK(contains(target({1, 1, 1, 1, 1, 1}, "VEC2", 2), "POSITION of the wrong type"));
    CHECK(contains(target({1, 1, 1}, "VEC3", 3, "77"), "accessor 77"));
    CHECK(contains(target({0, 0, 0, 0, 0, std::nanf(""), 0, 0, 0}, "VEC3", 3), "not finite"));
}
