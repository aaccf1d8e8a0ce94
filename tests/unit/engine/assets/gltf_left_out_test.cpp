// What the import leaves out, in words that lead to the place in the file.
#include "engine/assets/gltf/file/uri.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/describe.h"

#include <cmath>

using namespace raynest;
using test::contains;
using test::GlbWriter;
using test::must_describe;
using test::refusal;

namespace {

bool warns_of(const std::vector<std::string>& warnings, const std::string& text) {
    for (const std::string& warning : warnings)
        if (contains(warning, text)) return true;
    return false;
}

/// A triangle with these nodes and further members.
SceneDescription with_nodes(const std::string& nodes, const std::string& members = {}) {
    GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    return must_describe(writer.glb(mesh + R"(,"nodes":[)" + nodes + "]" + members));
}

}  // namespace

TEST_CASE("texture coordinates that are not finite, or too few, are left out of their primitive") {
    const float nan = std::nanf("");
    for (const auto& [values, why] :
         {std::pair{std::vector<float>{0, 0, 1, nan, 0, 1}, "is not finite at 1 vertex"},
          std::pair{std::vector<float>{0, nan, 1, INFINITY, 0, 1}, "is not finite at 2 vertices"},
          std::pair{std::vector<float>{0, 0, 1, 0}, "is for 2 vertices of 3"}}) {
        GlbWriter writer;
        writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
        writer.add_floats(values, "VEC2", 2);
        writer.add_floats({0, 0, 1, 0, 0, 1}, "VEC2", 2);
        const auto scene = must_describe(writer.glb(R"("meshes":[{"name":"leaf","primitives":[
            {"attributes":{"POSITION":0,"TEXCOORD_0":1,"TEXCOORD_1":2}},
            {"attributes":{"POSITION":0,"TEXCOORD_0":2}}]}],"nodes":[{"mesh":0}])"));
        const auto& geometries = scene.objects[0].geometries;
        CHECK(geometries[0].texcoords[0].empty());
        CHECK(geometries[0].texcoords[1].size() == 3);
        CHECK(geometries[1].texcoords[0].size() == 3);
        REQUIRE(scene.warnings.size() == 1);
        CHECK(scene.warnings[0] ==
              std::string("mesh 0 ('leaf'): its TEXCOORD_0 ") + why + "; it is left out there");
        CHECK(scene.skipped.at("texture_coordinate_sets") == 1);
    }
}

TEST_CASE("colours of vertices keep their dark tones") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    writer.add_floats({0.0018F, 0.003F, 0.0059F, 0.5F, 1, 0, 2, 1, std::nanf(""), -1, 0.5F, 0},
                      "VEC4", 4);
    const auto scene = must_describe(writer.glb(
        R"("meshes":[{"primitives":[{"attributes":{"POSITION":0,"COLOR_0":1}}]}],"nodes":[{"mesh":0}])"));
    // As sRGB has them; alpha is linear.
    CHECK(scene.objects[0].geometries[0].colours ==
          std::vector<std::uint8_t>{6, 10, 18, 128, 255, 0, 255, 255, 0, 0, 188, 0});
}

TEST_CASE("a placement that a scale of 0 flattens is named by its node") {
    const auto warnings_of = [](const std::string& nodes) {
        const auto snapshot = Snapshot::build(with_nodes(nodes));
        REQUIRE(snapshot.has_value());
        return (*snapshot)->statistics().warnings;
    };
    const std::string others = R"({"mesh":0},{"mesh":0,"translation":[9,0,0]},)";
    CHECK(warns_of(warnings_of(others + R"({"name":"flag","mesh":0,"scale":[1,1,0]})"),
                   "1 placement is left out, that of node 2 ('flag'): a scale of 0"));
    CHECK(warns_of(warnings_of(others + R"({"name":"a","scale":[1,0,1],"children":[3,4]},
                                            {"name":"b","mesh":0},{"name":"c","mesh":0})"),
                   "2 placements are left out, first that of node 3 ('b'): a scale of 0"));
    // A mesh lends its name to a node without one.
    CHECK(warns_of(warnings_of(others + R"({"mesh":0,"scale":[0,0,0]})"), "node 2 ('leaf')"));
}

TEST_CASE("a placement that reaches too far is named by its node") {
    const auto refused = [](const std::string& nodes) {
        const auto snapshot = Snapshot::build(with_nodes(nodes));
        REQUIRE_FALSE(snapshot.has_value());
        return snapshot.error().message;
    };
    CHECK(contains(refused(R"({"mesh":0},{"name":"big","mesh":0,"scale":[1e30,1e30,1e30]})"),
                   "node 1 ('big') reaches beyond 1e15"));
    CHECK(contains(refused(R"({"mesh":0},{"name":"far","mesh":0,"translation":[0,1e20,0]},
                              {"mesh":0,"scale":[1e30,1,1]})"),
                   "node 1 ('far') and 1 other reach beyond 1e15"));
}

TEST_CASE("cameras and lights that are left out are named by their number or their node") {
    const auto cameras = with_nodes(R"({"mesh":0},{"camera":0,"scale":[1,1,0]},{"camera":0})",
                                    R"(,"cameras":[{"type":"orthographic","orthographic":
                                    {"xmag":1,"ymag":1,"znear":0.1,"zfar":9}}])");
    CHECK(cameras.cameras.size() == 1);
    CHECK(
        warns_of(cameras.warnings, "node 1: its camera is left out, because it has no direction"));

    const auto lights = with_nodes(
        R"({"mesh":0},{"name":"lamp","extensions":{"KHR_lights_punctual":{"light":1}}},
           {"name":"n","scale":[0,0,0],"extensions":{"KHR_lights_punctual":{"light":0}}})",
        R"(,"extensions":{"KHR_lights_punctual":{"lights":[{"type":"point"},{"type":"area"}]}})");
    CHECK(lights.lights.empty());
    CHECK(warns_of(lights.warnings, "light 1 has the unknown type 'area' and is left out"));
    CHECK(warns_of(lights.warnings, "node 2 ('n'): its light is left out, because it has no dir"));
}

TEST_CASE("a picture that is missing is named by its number, with the materials that lose it") {
    const auto scene = with_nodes(R"({"mesh":0})",
                                  R"(,"images":[{"uri":"a.png"},{"uri":"100%.png"},{"uri":""}],
        "textures":[{"source":1},{"source":0},{"source":2},{}],
        "materials":[{"name":"oak","pbrMetallicRoughness":{"baseColorTexture":{"index":0}},
                      "occlusionTexture":{"index":0}},
                     {"emissiveTexture":{"index":0}},{"normalTexture":{"index":1}},
                     {"normalTexture":{"index":2}},{"name":"ash","normalTexture":{"index":3}}])");
    CHECK(scene.warnings.size() == 5);  // and that occlusion textures are not used
    CHECK(
        warns_of(scene.warnings,
                 "picture 1 ('100%.png') names '100%.png', which has a % without two hex digits "
                 "behind it; write %25 for the letter %; material 0 ('oak') and 1 other are shown "
                 "without it"));
    CHECK(warns_of(scene.warnings,
                   "picture 0 ('a.png') names the file 'a.png', which is missing; "
                   "material 2 is shown without it"));
    CHECK(warns_of(scene.warnings, "picture 2 names '', which is empty; name a file"));
    CHECK(warns_of(scene.warnings,
                   "texture 3 names no picture; material 4 ('ash') is shown without it"));
    CHECK(gltf::why_no_file("a%20b%2Fc.png") == "is not beside or below the scene");
    CHECK(contains(std::string(gltf::why_no_file("/a%.png")), "absolute path"));
}

TEST_CASE("factors of a texture that is missing neither light up nor turn to metal") {
    const auto scene = with_nodes(R"({"mesh":0})",
                                  R"(,"images":[{"uri":"a.png"}],"textures":[{"source":0}],
        "materials":[{"emissiveFactor":[1,1,1],"emissiveTexture":{"index":0}},
                     {"pbrMetallicRoughness":{"metallicFactor":1,"metallicRoughnessTexture":{"index":0}}},
                     {"emissiveFactor":[1,1,1],"pbrMetallicRoughness":{"metallicFactor":1}}])");
    CHECK(scene.materials[0].surface.emission == Vec3(0));
    CHECK(scene.materials[0].surface.metallic == 1);
    CHECK(scene.materials[1].surface.metallic == 0);
    CHECK(scene.materials[2].surface.emission == Vec3(1));
    CHECK(scene.materials[2].surface.metallic == 1);
}

TEST_CASE("pictures beyond what a scene may take are left out, each with a line" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    constexpr std::uint32_t side = 64;
    const test::Bytes picture =
        test::raw_png(side, side, 8, 6, std::string(std::size_t{side} * (4 * side + 1), '\0'));
    const std::string view = std::to_string(writer.add(picture, "SCALAR", 5121, 1));
    std::string images, textures, materials;
    for (int i = 0; i < 7; ++i) {
        const std::string number = std::to_string(i);
        for (std::string* list : {&images, &textures, &materials})
            if (i != 0) *list += ',';
        images.append(R"({"bufferView":)").append(view).append(R"(,"mimeType":"image/png"})");
        textures.append(R"({"source":)").append(number).append("}");
        materials.append(R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":)")
            .append(number)
            .append("}}}");
    }
    const test::Upload upload("scene.glb", writer.glb(mesh + R"(,"nodes":[{"mesh":0}],"images":[)" +
                                                      images + R"(],"textures":[)" + textures +
                                                      R"(],"materials":[)" + materials + "]"));
    ImportLimits limits;
    // Four such pictures for one file, and half of one.
    limits.image_bytes_max = std::uint64_t{4} * side * side + side * side / 2;
    const auto scene = must_describe(describe_gltf(upload.request(), limits));
    CHECK(scene.images.size() == 4);
    CHECK(scene.skipped.at("textures") == 3);
    REQUIRE(scene.warnings.size() == 3);
    for (int i = 0; i < 3; ++i) {
        const std::string& warning = scene.warnings[static_cast<std::size_t>(i)];
        const std::string number = std::to_string(4 + i);
        CAPTURE(warning);
        CHECK(contains(warning, "picture " + number + ": the picture is 64 x 64 pixels"));
        CHECK(contains(warning, "the scene's other pictures take the rest"));
        CHECK(contains(warning, "material " + number + " is shown without it"));
    }
}

TEST_CASE("a .glb that is none says what it begins with") {
    CHECK(contains(refusal(test::to_bytes("<!DOCTYPE html>\n<html>")),
                   "no GLB: it begins with "
                   "'<!DOCTYPE html> <html>'"));
    CHECK(contains(refusal(test::to_bytes("glTF1")), "ends inside its header"));
}
