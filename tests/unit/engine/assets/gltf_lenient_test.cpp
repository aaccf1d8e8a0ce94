// Harmless faults of a glTF: they are accepted, with a warning if the scene may look different from
// its author's intention. Only the parts in use must be valid.
#include "tests/unit/engine/assets/describe.h"

#include <utility>

using namespace raynest;
using test::contains;
using test::describe;
using test::GlbWriter;
using test::must_describe;
using test::one_triangle_mesh;
using test::refusal;

namespace {

/// Returns the only warning of a scene.
std::string warning(const SceneDescription& scene) {
    REQUIRE(scene.warnings.size() == 1);
    return scene.warnings[0];
}

/// Returns a .gltf of one triangle at (0,0,0), (1,0,0), (0,1,0), whose buffer is `buffer`.
test::Bytes triangle_of(const std::string& buffer, const std::string& more = {}) {
    return test::to_bytes(R"({"asset":{"version":"2.0"},"buffers":[)" + buffer +
                          R"(],"bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{
        "bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],"meshes":[{"primitives":[{
        "attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}])" +
                          more + "}");
}

using Edits = std::vector<std::pair<std::string, std::string>>;

/// Returns a GLB with parts of its JSON text replaced, and padded with blanks to `alignment`.
test::Bytes edited(const test::Bytes& glb, const Edits& edits, std::size_t alignment = 4) {
    const auto word = [](std::size_t value) {
        std::string text(4, '\0');
        const auto narrow = static_cast<std::uint32_t>(value);
        std::memcpy(text.data(), &narrow, 4);
        return text;
    };
    const std::string file(reinterpret_cast<const char*>(glb.data()), glb.size());
    std::uint32_t length = 0;
    std::memcpy(&length, file.data() + 12, 4);
    std::string json = file.substr(20, length);
    for (const auto& [from, to] : edits) {
        REQUIRE(contains(json, from));
        json.replace(json.find(from), from.size(), to);
    }
    while (json.back() == ' ') json.pop_back();
    while (json.size() % alignment != 0) json += ' ';
    const std::string rest = file.substr(20 + length);
    return test::to_bytes("glTF" + word(2) + word(20 + json.size() + rest.size()) +
                          word(json.size()) + "JSON" + json + rest);
}

std::size_t instances(const SceneDescription& scene) {
    return scene.objects[scene.root].instances.size();
}

const std::vector<Vec3> triangle{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
constexpr const char* triangle_base64 = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
const std::string percent =
    "%00%00%00%00%00%00%00%00%00%00%00%00%00%00%80%3f%00%00%00%00%00%00%00"
    "%00%00%00%00%00%00%00%80%3f%00%00%00%00";

}  // namespace

TEST_CASE("a data URI is base64 or percent-encoded, of any type") {
    for (const std::string& uri :
         {"data:application/octet-stream;base64," + std::string(triangle_base64),
          "data:application/x-whatever;base64," + std::string(triangle_base64),
          "data:;base64," + std::string(triangle_base64),
          "data:application/octet-stream," + percent, "data:," + percent}) {
        CAPTURE(uri);
        const auto scene =
            must_describe(triangle_of(R"({"byteLength":36,"uri":")" + uri + "\"}"), "scene.gltf");
        CHECK(scene.objects[0].geometries[0].positions == triangle);
        CHECK(scene.warnings.empty());
    }
    for (const std::string& uri :
         {std::string("data:"), std::string("data:;base64"), std::string("data:;base64,"),
          "data:;base64,!" + std::string(triangle_base64),
          "data:;base64,A" + std::string(triangle_base64), "data:,%0" + percent,
          "data:,%zz" + percent, "data:," + percent.substr(3),
          "data:;base64," + std::string(triangle_base64).substr(4),
          "data:;base64,    " + std::string(triangle_base64).substr(4),
          "data:;base64,AAA=" + std::string(triangle_base64).substr(4),
          "data:;base64," + std::string(triangle_base64).substr(4) + "\\n\\n\\n\\n"}) {
        CAPTURE(uri);
        CHECK(contains(
            refusal(triangle_of(R"({"byteLength":36,"uri":")" + uri + "\"}"), "scene.gltf"),
            "mesh 0 needs buffer 0, which has"));
    }
}

TEST_CASE("a buffer without data matters only if it is used") {
    CHECK(contains(refusal(triangle_of(R"({"byteLength":36})"), "scene.gltf"),
                   "mesh 0 needs buffer 0, which has no data"));
    CHECK(contains(refusal(triangle_of(R"({"byteLength":36,"uri":"gone.bin"})"), "scene.gltf"),
                   "mesh 0 needs buffer 0, which names the file 'gone.bin', which is missing"));
    const std::string good =
        R"({"byteLength":36,"uri":"data:;base64,)" + std::string(triangle_base64) + "\"}";
    for (const char* other :
         {R"({"byteLength":8})", R"({"byteLength":0})", "{}",
          R"({"byteLength":8,"uri":"gone.bin"})", R"({"byteLength":-8,"uri":"data:garbage"})"}) {
        CAPTURE(other);
        const auto scene = must_describe(triangle_of(good + "," + other), "scene.gltf");
        CHECK(scene.objects[0].geometries[0].positions == triangle);
    }
    // A second buffer does not get the binary chunk of a GLB either.
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    CHECK(contains(
        refusal(edited(writer.glb(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
                       "nodes":[{"mesh":0}])"),
                       {{R"("buffers":[)", R"("buffers":[{"byteLength":36},)"},
                        {R"("buffer":0)", R"("buffer":1)"}})),
        "mesh 0 needs buffer 1, which has no data"));
}

TEST_CASE("a buffer may be longer than the scene says, but not shorter") {
    test::Upload longer("scene.gltf", triangle_of(R"({"byteLength":36,"uri":"a.bin"})"));
    longer.add("a.bin", test::Bytes(40));
    CHECK(describe_gltf(longer.request(), ImportLimits{}).has_value());
    test::Upload shorter("scene.gltf", triangle_of(R"({"byteLength":36,"uri":"a.bin"})"));
    shorter.add("a.bin", test::Bytes(35));
    const auto refused = describe_gltf(shorter.request(), ImportLimits{});
    REQUIRE_FALSE(refused.has_value());
    CHECK(contains(refused.error().message, "it is cut short"));
}

TEST_CASE("an accessor without a bufferView is all zeros, up to a limit on memory") {
    const auto zeros = [](const std::string& position, const std::string& indices) {
        return test::to_bytes(R"({"asset":{"version":"2.0"},"nodes":[{"mesh":0}],"accessors":[
            {"componentType":5126,"count":)" +
                              position + R"(,"type":"VEC3"},
            {"componentType":5125,"count":)" +
                              indices + R"(,"type":"SCALAR"}],"meshes":[
            {"primitives":[{"attributes":{"POSITION":0},"indices":1}]}]})");
    };
    const auto scene = must_describe(zeros("3", "6"), "scene.gltf");
    CHECK(scene.objects[0].geometries[0].positions == std::vector<Vec3>(3, Vec3(0)));
    CHECK(scene.objects[0].geometries[0].indices == std::vector<std::uint32_t>(6, 0));
    for (const char* count : {"1048577", "4294967295", "4611686018427387904"}) {
        CHECK_FALSE(describe(zeros(count, "6"), "scene.gltf").has_value());
        CHECK_FALSE(describe(zeros("3", count), "scene.gltf").has_value());
    }
    GlbWriter writer;
    const auto triangle_mesh = writer.glb(one_triangle_mesh(writer) + R"(,"nodes":[{"mesh":0}])");
    CHECK(contains(refusal(edited(triangle_mesh, {{R"("count":3)", R"("count":-3)"}})),
                   "which has an unknown type or no valid count"));
}

TEST_CASE("sparse indices are read") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0}, "VEC3", 3);
    writer.add_indices({0});
    writer.add_indices({3});
    writer.add<std::uint16_t>({0, 1, 2}, "SCALAR", 5123, 1,
                              R"(,"sparse":{"count":1,"indices":{"bufferView":1,
        "componentType":5123},"values":{"bufferView":2}})");
    const auto scene = must_describe(writer.glb(
        R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":3}]}],"nodes":[{"mesh":0}])"));
    CHECK(scene.objects[0].geometries[0].positions ==
          std::vector<Vec3>{{1, 0, 0}, {0, 1, 0}, {1, 1, 0}});
}

TEST_CASE("an accessor of an unknown type matters only if it is used") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto with = [&](const char* type, int component, const std::string& more) {
        GlbWriter other = writer;
        other.add<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}, type, component, 3);
        return other.glb(more);
    };
    const std::string unused = mesh + R"(,"nodes":[{"mesh":0}])";
    const std::string used =
        R"("meshes":[{"primitives":[{"attributes":{"POSITION":1}}]}],"nodes":[{"mesh":0}])";
    struct Odd {
        const char* type;
        int component;
    };
    for (const Odd odd :
         {Odd{"VEC5", 5126}, Odd{"VEC3", 5124}, Odd{"VEC3", 5130}, Odd{"VEC3", 0}, Odd{"", 99}}) {
        CAPTURE(odd.type);
        CAPTURE(odd.component);
        CHECK(must_describe(with(odd.type, odd.component, unused)).warnings.empty());
        CHECK(contains(refusal(with(odd.type, odd.component, used)),
                       "mesh 0 needs accessor 1, which has"));
    }
}

TEST_CASE("accessors that are not aligned are read bytewise, with one warning") {
    GlbWriter writer;
    writer.add<std::uint8_t>({9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,   0,  0, 128, 63, 0, 0,
                              0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 128, 63, 0, 0,   0,  0},
                             "SCALAR", 5121, 1);
    const auto scene = must_describe(edited(
        writer.glb(
            R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}])"),
        {{R"("componentType":5121,"count":37,"type":"SCALAR")",
          R"("byteOffset":1,"componentType":5126,"count":3,"type":"VEC3")"}}));
    CHECK(scene.objects[0].geometries[0].positions == triangle);
    CHECK(contains(warning(scene), "1 accessor is not aligned"));
}

TEST_CASE("a byteStride of 0 means packed, another one is kept") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 7, 1, 0, 0, 7, 0, 1, 0, 7}, "VEC3", 3);
    const test::Bytes packed = writer.glb(
        R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}])");
    const auto stride = [&](const char* bytes) {
        return must_describe(
                   edited(packed, {{R"("byteLength":48})",
                                    std::string(R"("byteLength":48,"byteStride":)") + bytes + "}"},
                                   {R"("count":4)", R"("count":3)"}}))
            .objects[0]
            .geometries[0]
            .positions;
    };
    CHECK(stride("16") == triangle);
    CHECK(stride("0") == std::vector<Vec3>{{0, 0, 0}, {7, 1, 0}, {0, 7, 0}});
}

TEST_CASE("a byteStride that is not a multiple of 4 is read, with a warning") {
    // Positions of three u16.
    for (const std::size_t stride : {6U, 7U, 300U}) {
        CAPTURE(stride);
        GlbWriter writer;
        std::vector<std::uint8_t> bytes(3 * stride);
        bytes[stride] = 1;
        bytes[2 * stride + 2] = 1;
        writer.add(bytes, "VEC3", 5123, stride);
        const test::Bytes packed = writer.glb(
            R"("extensionsUsed":["KHR_mesh_quantization"],)"
            R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}])");
        const std::string length = R"("byteLength":)" + std::to_string(bytes.size()) + "}";
        const auto scene = must_describe(
            edited(packed, {{length, length.substr(0, length.size() - 1) + R"(,"byteStride":)" +
                                         std::to_string(stride) + "}"}}));
        CHECK(scene.objects[0].geometries[0].positions == triangle);
        if (stride % 4 != 0) CHECK(contains(warning(scene), "1 accessor is not aligned"));
    }
}

TEST_CASE("an integer may be written with a fraction of 0") {
    const auto scene = must_describe(triangle_of(R"({"byteLength":36.0,"uri":"data:;base64,)" +
                                                     std::string(triangle_base64) + "\"}",
                                                 R"(,"scenes":[{"nodes":[0.0]}],"scene":0.0)"),
                                     "scene.gltf");
    CHECK(instances(scene) == 1);
    for (const char* odd : {"36.5", "1e300", "-36.0", "3.6e1000"}) {
        CAPTURE(odd);
        CHECK_FALSE(
            describe(triangle_of(std::string(R"({"byteLength":)") + odd +
                                 R"(,"uri":"data:;triangle_base64,)" + triangle_base64 + "\"}"),
                     "scene.gltf")
                .has_value());
    }
}

TEST_CASE("a GLB may have bytes after its end and an unaligned JSON chunk") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    test::Bytes glb = writer.glb(mesh + R"(,"nodes":[{"mesh":0}])");
    for (int i = 0; i < 7; ++i) {
        glb.push_back(std::byte{'x'});
        CHECK(must_describe(glb).objects[0].geometries[0].positions == triangle);
    }
    for (const char* blanks : {"", " ", "  ", "   "}) {
        const auto odd = edited(writer.glb(mesh + R"(,"nodes":[{"mesh":0}])"),
                                {{R"("nodes")", std::string(blanks) + R"("nodes")"}}, 1);
        CHECK(must_describe(odd).objects[0].geometries[0].positions == triangle);
    }
}

TEST_CASE("a camera with odd numbers is shown with usual ones") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    for (const char* camera : {R"({"type":"perspective","perspective":{"yfov":0,"znear":1}})",
                               R"({"type":"perspective","perspective":{"yfov":-1,"znear":1}})",
                               R"({"type":"perspective","perspective":{"yfov":3.2,"znear":1}})",
                               R"({"type":"perspective","perspective":{"yfov":1e300,"znear":1}})",
                               R"({"type":"perspective","perspective":{"yfov":"wide","znear":1}})",
                               R"({"type":"perspective","perspective":{}})",
                               R"({"type":"perspective"})", R"({"type":"fisheye"})", "{}"}) {
        CAPTURE(camera);
        const auto scene =
            must_describe(writer.glb(mesh + R"(,"cameras":[)" + camera +
                                     R"(],"nodes":[{"mesh":0},{"name":"eye","camera":0}])"));
        REQUIRE(scene.cameras.size() == 1);
        CHECK(scene.cameras[0].yfov == 0.7F);
        const bool is_typed = contains(camera, "perspective");
        CHECK(contains(warning(scene), is_typed ? "camera 0 ('eye'): its yfov is outside (0, pi)"
                                                : "camera 0 ('eye'): its type is unknown"));
    }
}

TEST_CASE("an orthographic camera with odd numbers shows two by two metres") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    for (const char* numbers :
         {R"("xmag":0,"ymag":1)", R"("xmag":1,"ymag":0)", R"("xmag":1e300,"ymag":1)",
          R"("xmag":1,"ymag":1e-300)", R"("xmag":"1","ymag":1)", R"("ymag":1)", ""}) {
        CAPTURE(numbers);
        const auto scene = must_describe(
            writer.glb(mesh + R"(,"cameras":[{"type":"orthographic","orthographic":{)" + numbers +
                       R"(}}],"nodes":[{"mesh":0},{"name":"eye","camera":0}])"));
        REQUIRE(scene.cameras.size() == 1);
        CHECK(scene.cameras[0].ymag == 1);
        CHECK(scene.cameras[0].aspect == 1);
        CHECK(contains(warning(scene), "camera 0 ('eye'): its xmag or ymag is 0"));
    }
}

TEST_CASE("a choice of a missing scene counts as no choice") {
    GlbWriter writer;
    const std::string nodes = one_triangle_mesh(writer) + R"(,"nodes":[{"mesh":0},{"mesh":0}])";
    for (const char* choice : {"1", "-2", "7"}) {
        const std::string chosen = std::string(",\"scene\":") + choice;
        const auto first =
            must_describe(writer.glb(nodes + R"(,"scenes":[{"nodes":[1]}])" + chosen));
        CHECK(instances(first) == 1);
        CHECK(contains(warning(first), "scene 0 is shown"));
        const auto all = must_describe(writer.glb(nodes + chosen));
        CHECK(instances(all) == 2);
        CHECK(contains(warning(all), "all nodes are shown"));
    }
}

TEST_CASE("a node that the scene lists and a parent holds is shown once") {
    GlbWriter writer;
    const std::string nodes = one_triangle_mesh(writer) +
                              R"(,"nodes":[{"children":[1],"translation":[1,0,0]},
        {"children":[2],"translation":[1,0,0]},{"mesh":0,"translation":[1,0,0]}],"scenes":[{"nodes":[)";
    const auto x_of = [&](const char* listed) {
        const auto scene = must_describe(writer.glb(nodes + listed + "]}]"));
        REQUIRE(instances(scene) == 1);
        CHECK_FALSE(scene.warnings.empty());
        return scene.objects[scene.root].instances[0].transform.point({0, 0, 0}).x;
    };
    CHECK(x_of("0,1") == 3);
    CHECK(x_of("1,0") == 3);
    CHECK(x_of("2,0") == 3);  // below its grandparent
    CHECK(x_of("2,1") == 2);
    CHECK(x_of("2") == 1);
    CHECK(must_describe(writer.glb(nodes + "0]}]")).warnings.empty());
    CHECK(contains(refusal(writer.glb(nodes + "0,9]}]")), "scene node 9"));
}

TEST_CASE("a hidden node hides the meshes of all below it, and nothing else") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene_of = [&](const std::string& visibility) {
        return must_describe(writer.glb(mesh + R"(,"extensionsUsed":["KHR_node_visibility"],
            "cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":1}}],"nodes":[
            {"mesh":0,"children":[1]},{"mesh":0,"children":[2],"extensions":{"KHR_node_visibility":)" +
                                        visibility +
                                        R"(}},{"mesh":0,"children":[3]},{"mesh":0,"camera":0,
            "extensions":{"KHR_node_visibility":{"visible":true}}}])"));
    };
    const auto hidden = scene_of(R"({"visible":false})");
    CHECK(instances(hidden) == 1);
    CHECK(hidden.skipped.at("hidden_instances") == 3);
    CHECK(hidden.cameras.size() == 1);
    CHECK(hidden.warnings.empty());
    for (const char* odd :
         {"{}", R"({"visible":true})", R"({"visible":0})", R"({"visible":"no"})",
          R"({"visible":null})", R"({"visible":[false]})", "[]", "false", "null"}) {
        CAPTURE(odd);
        CHECK(instances(scene_of(odd)) == 4);
    }
}

TEST_CASE("extensions in use that are not read are named in one warning") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer) + R"(,"nodes":[{"mesh":0}])";
    const auto used = [&](const std::string& names) {
        return must_describe(writer.glb(mesh + R"(,"extensionsUsed":[)" + names + "]"));
    };
    CHECK(contains(warning(used(R"("MSFT_lod","KHR_materials_ior","EXT_new","MSFT_lod")")),
                   "does not read: EXT_new, MSFT_lod"));
    CHECK(used(R"("KHR_materials_clearcoat","KHR_lights_punctual","KHR_texture_transform")")
              .warnings.empty());
    std::string many;
    for (int i = 0; i < 1000; ++i) many += "\"EXT_\\u001b" + std::to_string(i) + "\",";
    many.pop_back();
    CHECK(warning(used(many)).size() < 500);
    CHECK(
        contains(refusal(writer.glb(mesh + R"(,"extensionsRequired":["EXT_new"])")), "'EXT_new'"));
}

TEST_CASE("the diffuse colour of specular-glossiness counts, and its alpha") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer) + R"(,"nodes":[{"mesh":0}])";
    const auto material = [&](const std::string& extension) {
        return writer.glb(mesh + R"(,"textures":[{},{}],"materials":[{"alphaMode":"MASK",
            "pbrMetallicRoughness":{"baseColorFactor":[1,1,1,1]},"extensions":{
            "KHR_materials_pbrSpecularGlossiness":)" +
                          extension + "}}]");
    };
    const auto scene = must_describe(material(R"({"diffuseFactor":[0.1,0.2,0.3,0.4]})"));
    CHECK(scene.materials[0].base_colour == Vec4(0.1F, 0.2F, 0.3F, 0.4F));
    CHECK(must_describe(material("{}")).materials[0].base_colour == Vec4(1.0F));
    for (
        const char* odd :
        {R"({"diffuseFactor":[1,1,1]})", R"({"diffuseFactor":"red"})",
         R"({"diffuseFactor":[1,1,1,1e300]})", R"({"diffuseTexture":{"texCoord":0}})",
         R"({"diffuseTexture":{"index":2}})", R"({"diffuseTexture":{"index":"0"}})",
         R"({"diffuseTexture":{"index":0,"texCoord":-1}})",
         R"({"diffuseTexture":{"index":0,"texCoord":"1"}})",
         R"({"diffuseTexture":{"index":0,"extensions":{"KHR_texture_transform":{"scale":[1]}}}})"}) {
        CAPTURE(odd);
        const auto loaded = describe(material(odd));
        CHECK((!loaded || !loaded->warnings.empty()));
    }
}

TEST_CASE("the texture of specular-glossiness comes with its set and its transform" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const int view = writer.add(test::raw_png(1, 1, 8, 6, std::string("\0\x10\x20\x30\x40", 5)),
                                "SCALAR", 5121, 1);
    const auto scene = must_describe(writer.glb(
        mesh + R"(,"nodes":[{"mesh":0}],"images":[{"bufferView":)" + std::to_string(view) +
        R"(,"mimeType":"image/png"}],"textures":[{"source":0}],"materials":[{"extensions":{
        "KHR_materials_pbrSpecularGlossiness":{"diffuseTexture":{"index":0,"texCoord":1,"extensions":{
        "KHR_texture_transform":{"offset":[0.5,0.25]}}}}}}])"));
    CHECK(scene.materials[0].texture == 0);
    CHECK(scene.materials[0].texcoord == 1);
    CHECK(scene.materials[0].uv_transform[2] == 0.5F);
}

TEST_CASE(
    "an odd value of a material or a node becomes its default, with a warning that names it") {
    const auto load = [](const std::string& material, const std::string& sampler = {},
                         const std::string& node = {}) {
        GlbWriter writer;
        const std::string mesh = one_triangle_mesh(writer);
        return must_describe(writer.glb(
            mesh +
            R"(,"textures":[{"sampler":0,"source":0}],"images":[{"uri":"data:,x"}],"samplers":[{)" +
            sampler + R"(}],"materials":[{"name":"leaf",)" + material +
            R"(}],"nodes":[{"mesh":0,"name":"oak")" + node + "}]"));
    };
    struct Case {
        const char *material, *sampler, *node, *text;
    };
    constexpr const char* plain = R"("doubleSided":false)";
    for (const auto& [material, sampler, node, text] :
         {Case{R"("alphaCutoff":-1)", "", "", "material 0 ('leaf'): alphaCutoff is negative"},
          Case{R"("alphaCutoff":"x")", "", "", "material 0 ('leaf'): alphaCutoff is not a number"},
          Case{R"("alphaMode":"mask")", "", "", "material 0 ('leaf'): alphaMode is none of OPAQUE"},
          Case{R"("alphaMode":3)", "", "", "material 0 ('leaf'): alphaMode is not a text"},
          Case{R"("pbrMetallicRoughness":{"baseColorFactor":[1,0,0]})", "", "",
               "material 0 ('leaf'): baseColorFactor is not four numbers"},
          Case{R"("pbrMetallicRoughness":{"baseColorFactor":1})", "", "",
               "material 0 ('leaf'): baseColorFactor is not a list of numbers"},
          Case{plain, R"("wrapS":7)", "", "sampler 0: its wrapS or wrapT is unknown"},
          Case{plain, R"("magFilter":7)", "", "sampler 0: its magFilter is unknown"},
          Case{plain, "", R"(,"scale":2)", "node 0 ('oak'): scale is not a list of numbers"},
          Case{plain, "", R"(,"camera":0.5)", "node 0 ('oak'): camera is not a whole number"}}) {
        CAPTURE(text);
        const auto scene = load(material, sampler, node);
        CHECK(contains(warning(scene), text));
        const MaterialDescription& read = scene.materials[0];
        CHECK(read.cutoff == 0.5F);
        CHECK(read.alpha_mode == AlphaMode::opaque);
        CHECK(read.base_colour == Vec4(1));
        CHECK(scene.objects[scene.root].instances[0].transform == Transform{});
    }
    CHECK(load(plain, R"("wrapS":33071,"magFilter":9729)", R"(,"scale":[1,1,1])").warnings.empty());
}

TEST_CASE("a texture without the texture coordinates that it needs is left out with a warning") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(
        edited(writer.glb(mesh + R"(,"textures":[{"source":0}],"images":[{"uri":"data:,x"}],
               "materials":[{"name":"x","pbrMetallicRoughness":{"baseColorTexture":{"index":0,
               "texCoord":1}}}],"nodes":[{"mesh":0}])"),
               {{R"("attributes":{)", R"("material":0,"attributes":{)"}}));
    const auto found =
        std::find_if(scene.warnings.begin(), scene.warnings.end(), [](const std::string& text) {
            return contains(text,
                            "mesh 0 ('leaf') has no TEXCOORD_1, which material 0 ('x') needs");
        });
    CHECK(found != scene.warnings.end());
}
