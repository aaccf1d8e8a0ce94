#include "engine/assets/import.h"
#include "engine/scene/snapshot.h"
#include "tests/unit/engine/assets/describe.h"

using namespace raynest;
using test::contains;
using test::describe;
using test::GlbWriter;
using test::must_describe;
using test::one_triangle_mesh;
using test::refusal;

namespace {

std::string indexed_mesh(GlbWriter& writer, const std::vector<std::uint16_t>& indices, int mode) {
    const int position =
        writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 2, 1, 0}, "VEC3", 3);
    const int index = writer.add_indices(indices);
    return "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":" +
           std::to_string(position) + "},\"indices\":" + std::to_string(index) +
           ",\"mode\":" + std::to_string(mode) + "}]}]";
}

std::vector<std::uint32_t> triangles_of(const std::vector<std::uint16_t>& indices, int mode) {
    GlbWriter writer;
    const std::string mesh = indexed_mesh(writer, indices, mode);
    const auto scene = must_describe(writer.glb(mesh + ",\"nodes\":[{\"mesh\":0}]"));
    REQUIRE(scene.objects[0].geometries.size() == 1);
    return scene.objects[0].geometries[0].indices;
}

}  // namespace

TEST_CASE("lists, strips and fans become triangles in file order") {
    CHECK(triangles_of({0, 1, 2, 1, 3, 2}, 4) == std::vector<std::uint32_t>{0, 1, 2, 1, 3, 2});
    // glTF 2.0, 3.7.2.1: p_i = {v_i, v_{i+(1+i%2)}, v_{i+(2-i%2)}} and {v_{i+1}, v_{i+2}, v_0}.
    CHECK(triangles_of({0, 1, 2, 3, 4}, 5) ==
          std::vector<std::uint32_t>{0, 1, 2, 1, 3, 2, 2, 3, 4});
    CHECK(triangles_of({0, 1, 2, 3, 4}, 6) ==
          std::vector<std::uint32_t>{1, 2, 0, 2, 3, 0, 3, 4, 0});
}

TEST_CASE("a primitive takes only the vertices that it uses") {
    GlbWriter writer;
    const std::string mesh = indexed_mesh(writer, {4, 1, 3}, 4);
    const auto scene = must_describe(writer.glb(mesh + ",\"nodes\":[{\"mesh\":0}]"));
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    REQUIRE(geometry.positions.size() == 3);
    CHECK(geometry.positions[geometry.indices[0]] == Vec3(2, 1, 0));
    CHECK(geometry.positions[geometry.indices[1]] == Vec3(1, 0, 0));
    CHECK(geometry.positions[geometry.indices[2]] == Vec3(1, 1, 0));
}

TEST_CASE("points and lines are left out, counted and warned about") {
    for (const int mode : {0, 1, 2, 3}) {
        GlbWriter writer;
        const std::string mesh = indexed_mesh(writer, {0, 1, 2}, mode);
        const auto scene =
            must_describe(writer.glb(mesh + ",\"nodes\":[{\"mesh\":0},{\"mesh\":0}]"));
        CHECK(scene.skipped.at(mode == 0 ? "points" : "lines") == 1);
        CHECK(scene.skipped.at("instances_without_triangles") == 2);
        CHECK(scene.objects[scene.root].instances.empty());
        CHECK(scene.warnings.size() == 1);
    }
}

TEST_CASE("transforms are composed, names kept by node") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(writer.glb(
        mesh + R"(,"nodes":[{"name":"tree","translation":[1,2,3],"scale":[2,2,2],"children":[1]},
                  {"name":"leaf","mesh":0,"rotation":[0,0,1.4142135,1.4142135],"translation":[1,0,0]}])"));
    const auto& instances = scene.objects[scene.root].instances;
    REQUIRE(instances.size() == 1);
    REQUIRE(scene.path_nodes.size() == 3);
    CHECK(scene.path_nodes[1].name == "tree");
    CHECK(scene.path_nodes[2].parent == 1);
    CHECK(scene.path_nodes[2].source == 1);
    CHECK(scene.placed_nodes == std::vector<std::uint32_t>{2});
    // The transform is a quarter turn about z, normalised; scaled by two; moved.
    const Vec3 p = instances[0].transform.point({1, 0, 0});
    CHECK(p.x == doctest::Approx(3));
    CHECK(p.y == doctest::Approx(4));
    CHECK(p.z == doctest::Approx(3));
}

TEST_CASE("equal subtrees become one object, and equal subtrees of those too") {
    // Two stands of two equal trees of two leaves each; a third tree stands alone and is different.
    GlbWriter writer;
    std::string nodes =
        R"({"name":"stand-a","children":[2,3]},{"name":"stand-b","translation":[9,0,0],
        "children":[4,5]})";
    int next = 6;
    for (int tree = 0; tree < 4; ++tree) {
        nodes += ",{\"name\":\"tree\",\"translation\":[" + std::to_string(tree % 2 * 3) +
                 ",0,0],\"children\":[" + std::to_string(next) + "," + std::to_string(next + 1) +
                 "]}";
        next += 2;
    }
    for (int leaf = 0; leaf < 8; ++leaf) {
        nodes += ",{\"name\":\"leaf\",\"mesh\":0,\"translation\":[0," + std::to_string(leaf % 2) +
                 ",0]}";
    }
    nodes += R"(,{"name":"lone","children":[15,16]},{"mesh":0},{"mesh":0,"translation":[0,5,0]})";
    const auto mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(writer.glb(mesh + ",\"nodes\":[" + nodes + "]"));

    // mesh, tree, stand, root
    REQUIRE(scene.objects.size() == 4);
    const auto& root = scene.objects[scene.root].instances;
    REQUIRE(root.size() == 4);
    CHECK(root[0].object == root[1].object);
    CHECK(root[2].object == 0);

    const auto snapshot = Snapshot::build(scene);
    REQUIRE(snapshot.has_value());
    CHECK((*snapshot)->statistics().levels == 4);
    CHECK((*snapshot)->statistics().instances == 10);
    const auto path = expand_path(**snapshot, 3);
    REQUIRE(path.has_value());
    CHECK(path_name(*path) == "stand-a/tree#1/leaf#1");
}

TEST_CASE("equal subtrees inside each other share no more levels than a GPU supports") {
    // Chain k is node k of 40: a mesh and, one to the side, chain k - 1. The scene places each.
    GlbWriter writer;
    std::string nodes;
    std::string roots;
    int count = 0;
    for (int k = 1; k <= 40; ++k) {
        if (k > 1) roots += ',';
        roots += std::to_string(count);
        for (int level = k; level > 0; --level) {
            if (count++ > 0) nodes += ',';
            nodes += R"({"mesh":0,"translation":[1,0,0])";
            if (level > 1) nodes += ",\"children\":[" + std::to_string(count) + "]";
            nodes += '}';
        }
    }
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(
        writer.glb(mesh + R"(,"scenes":[{"nodes":[)" + roots + R"(]}],"nodes":[)" + nodes + "]"));
    const auto snapshot = Snapshot::build(scene);
    REQUIRE_MESSAGE(snapshot.has_value(), (snapshot ? "" : snapshot.error().message));
    CHECK((*snapshot)->statistics().levels == 8);
    CHECK((*snapshot)->statistics().instances == 40 * 41 / 2);
    // Subtrees that are not shared still place their meshes.
    CHECK(scene.objects[scene.root].instances.size() < 40 * 41 / 2);
}

TEST_CASE("EXT_mesh_gpu_instancing places a mesh once per element") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const int translation = writer.add_floats({1, 0, 0, 2, 0, 0, 3, 0, 0}, "VEC3", 3);
    const int scale = writer.add_floats({1, 1, 1, 2, 2, 2, 0, 1, 1}, "VEC3", 3);
    const auto nodes = [&](int t, int s) {
        return R"(,"extensionsRequired":["EXT_mesh_gpu_instancing"],"nodes":[{"name":"n","mesh":0,
               "translation":[0,0,7],"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":)" +
               std::to_string(t) + ",\"SCALE\":" + std::to_string(s) + "}}}}]";
    };
    const auto scene = must_describe(writer.glb(mesh + nodes(translation, scale)));
    const auto& instances = scene.objects[scene.root].instances;
    REQUIRE(instances.size() == 3);
    CHECK(instances[1].transform.point({1, 0, 0}) == Vec3(4, 0, 7));
    const auto snapshot = Snapshot::build(scene);
    REQUIRE(snapshot.has_value());
    CHECK((*snapshot)->statistics().instances == 2);
    CHECK((*snapshot)->statistics().skipped.at("singular_instances") == 1);
    CHECK(path_name(*expand_path(**snapshot, 1)) == "n#1");

    const int two = writer.add_floats({1, 1, 1, 2, 2, 2}, "VEC3", 3);
    CHECK(contains(refusal(writer.glb(mesh + nodes(translation, two))),
                   "elements where others have"));
    CHECK(contains(refusal(writer.glb(mesh + nodes(translation, 99))), "accessor 99"));
    const int flat = writer.add_floats({1, 1, 2, 2, 3, 3}, "VEC2", 2);
    CHECK(contains(refusal(writer.glb(mesh + nodes(translation, flat))), "wrong type"));
}

TEST_CASE("quantised positions and normalised texture coordinates are converted") {
    GlbWriter writer;
    writer.add<std::int16_t>({0, 0, 0, 32767, 0, 0, 0, -32767, 0}, "VEC3", 5122, 3,
                             ",\"normalized\":true");
    writer.add<std::uint8_t>({0, 255, 51, 0, 255, 255}, "VEC2", 5121, 2, ",\"normalized\":true");
    const std::string mesh =
        R"("meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1}}]}],
        "nodes":[{"mesh":0}])";
    const auto scene =
        must_describe(writer.glb(mesh + R"(,"extensionsUsed":["KHR_mesh_quantization"],
        "extensionsRequired":["KHR_mesh_quantization"])"));
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.positions == std::vector<Vec3>{{0, 0, 0}, {1, 0, 0}, {0, -1, 0}});
    CHECK(geometry.texcoords[0] == std::vector<Vec2>{{0, 1}, {0.2F, 0}, {1, 1}});
    CHECK(contains(refusal(writer.glb(mesh)), "POSITION of the wrong type"));
}

TEST_CASE("names from a file cannot write control characters to a terminal") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(writer.glb(
        mesh + R"(,"nodes":[{"name":"a\u001b[2J\nb","mesh":0}],"materials":[{"name":"\u0007"}])"));
    CHECK(scene.path_nodes[1].name == "a [2J b");
    CHECK(scene.materials[0].name.empty());
    CHECK(contains(refusal(writer.glb(mesh + R"(,"nodes":[{"mesh":0}],"n\nn":1,"n\nn":2)")),
                   "'n n'"));
}

TEST_CASE("sparse accessors replace single elements") {
    GlbWriter writer;
    writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    writer.add_indices({2, 0});
    writer.add_floats({0, 5, 0}, "VEC3", 3);
    const auto with_sparse = [&](int count) {
        // The writer closes the accessor list, so the sparse accessor is added as a fourth one over
        // bufferView 0.
        GlbWriter sparse = writer;
        sparse.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
        sparse.add<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 5126, 3,
                          ",\"sparse\":{\"count\":" + std::to_string(count) +
                              ",\"indices\":{\"bufferView\":1,\"componentType\":5123},"
                              "\"values\":{\"bufferView\":2}}");
        return sparse.glb(
            R"("meshes":[{"primitives":[{"attributes":{"POSITION":4}}]}],"nodes":[{"mesh":0}])");
    };
    const auto scene = must_describe(with_sparse(1));
    CHECK(scene.objects[0].geometries[0].positions[2] == Vec3(0, 5, 0));
    CHECK(contains(refusal(with_sparse(2)), "sparse"));
}

TEST_CASE("materials keep their alpha rule, their sampler and their texture transform" *
          doctest::test_suite("images")) {
    if (!test::have_images()) return;
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto picture = test::raw_png(1, 1, 8, 6, std::string("\0\x10\x20\x30\x40", 5));
    const int view = writer.add(picture, "SCALAR", 5121, 1);
    const auto scene = must_describe(writer.glb(mesh + R"(,"nodes":[{"mesh":0}],
        "images":[{"bufferView":)" + std::to_string(view) +
                                                R"(,"mimeType":"image/png"}],
        "samplers":[{"magFilter":9728,"wrapS":33071,"wrapT":33648}],
        "textures":[{"source":0,"sampler":0}],
        "materials":[{"name":"m","alphaMode":"MASK","alphaCutoff":0.25,"doubleSided":true,
          "pbrMetallicRoughness":{"baseColorFactor":[0.1,0.2,0.3,0.4],"baseColorTexture":{"index":0,
          "extensions":{"KHR_texture_transform":{"offset":[0.5,0.25],"scale":[2,4],
          "rotation":1.5707963267948966,"texCoord":1}}}}},{"alphaMode":"BLEND"}])"));
    REQUIRE(scene.materials.size() == 2);
    const MaterialDescription& m = scene.materials[0];
    CHECK(m.alpha_mode == AlphaMode::mask);
    CHECK(m.cutoff == 0.25F);
    CHECK(m.double_sided);
    CHECK(m.base_colour.a == 0.4F);
    CHECK(m.texcoord == 1);
    CHECK(scene.materials[1].alpha_mode == AlphaMode::blend);
    // A quarter turn: s = 4 v + 0.5, t = -2 u + 0.25.
    const float expected[6] = {0, 4, 0.5F, -2, 0, 0.25F};
    for (std::size_t i = 0; i < 6; ++i) CHECK(m.uv_transform[i] == doctest::Approx(expected[i]));
    REQUIRE(scene.textures.size() == 1);
    CHECK(scene.textures[0].nearest);
    CHECK(scene.textures[0].wrap_s == Wrap::clamp);
    CHECK(scene.textures[0].wrap_t == Wrap::mirror);
    CHECK(scene.images[0].rgba == std::vector<std::uint8_t>{16, 32, 48, 64});
}

TEST_CASE("a scene loads without the textures that are missing or damaged, and says so") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const int garbage = writer.add(test::to_bytes("this is no picture"), "SCALAR", 5121, 1);
    const int bomb = writer.add(test::raw_png(20000, 20000, 8, 0, "x"), "SCALAR", 5121, 1);
    const auto scene = must_describe(writer.glb(mesh + R"(,"nodes":[{"mesh":0}],
        "images":[{"uri":"gone.png"},{"bufferView":)" +
                                                std::to_string(garbage) +
                                                R"(,"mimeType":"image/png"},{"bufferView":)" +
                                                std::to_string(bomb) + R"(,"mimeType":"image/png"}],
        "textures":[{"source":0},{"source":1},{"source":2}],
        "materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}},
                     {"pbrMetallicRoughness":{"baseColorTexture":{"index":1}}},
                     {"pbrMetallicRoughness":{"baseColorTexture":{"index":2}}}])"));
    CHECK(scene.skipped.at("textures") == 3);
    CHECK(scene.warnings.size() == 3);
    CHECK(scene.images.empty());
    for (const MaterialDescription& material : scene.materials) CHECK(material.texture == no_id);
}

TEST_CASE("cameras come in node order, without their node's scale") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(writer.glb(mesh + R"(,
        "cameras":[{"type":"perspective","perspective":{"yfov":0.8,"znear":0.1,"aspectRatio":2}},
                   {"type":"orthographic","orthographic":{"xmag":3,"ymag":2,"znear":0.1,"zfar":9}}],
        "nodes":[{"children":[2],"scale":[5,5,5]},{"name":"flat","camera":1},
                 {"name":"eye","camera":0,"translation":[0,0,1]},{"mesh":0},
                 {"scale":[1e30,1e30,1e30],"children":[5,6]},{"camera":0,"scale":[1e30,1e30,1e30]},
                 {"camera":0,"translation":[1e30,0,0]}])"));
    REQUIRE(scene.cameras.size() == 3);  // a scale may exceed a float, a position must not
    CHECK(scene.cameras[2].to_world == Transform{});
    CHECK(scene.cameras[0].name == "flat");
    CHECK(scene.cameras[0].yfov == 0);
    CHECK(scene.cameras[0].ymag == 2);
    CHECK(scene.cameras[0].aspect == 1.5F);
    CHECK(scene.cameras[1].name == "eye");
    CHECK(scene.cameras[1].yfov == 0.8F);
    CHECK(scene.cameras[1].ymag == 0);
    CHECK(scene.cameras[1].aspect == 2);
    CHECK(scene.cameras[1].to_world.m == std::array<float, 12>{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 5});
    CHECK(scene.skipped.at("cameras") == 1);
}

TEST_CASE("a thousand omissions are counted, and a few of them warned about") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    std::string nodes = R"({"mesh":0})";
    std::string materials;
    for (int i = 0; i < 1000; ++i) {
        nodes += R"(,{"camera":0,"scale":[0,0,0]})";
        if (i > 0) materials += ',';
        materials += R"({"pbrMetallicRoughness":{"baseColorTexture":{"index":)" +
                     std::to_string(i) + R"(}}})";
    }
    std::string textures = "{}";
    for (int i = 1; i < 1000; ++i) textures += ",{}";
    const auto scene = must_describe(writer.glb(
        mesh + R"(,"cameras":[{"type":"orthographic","orthographic":{"xmag":1,"ymag":1,"znear":0.1,
        "zfar":9}}],"nodes":[)" +
        nodes + R"(],"textures":[)" + textures + R"(],"materials":[)" + materials + "]"));
    CHECK(scene.skipped.at("cameras") == 1000);
    CHECK(scene.skipped.at("textures") == 1000);
    CHECK(scene.warnings.size() == 18);
    CHECK(scene.warnings.back() == "more textures are left out");
}

TEST_CASE("a missing picture that no material uses is counted apart") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    const auto scene = must_describe(
        writer.glb(mesh + R"(,"nodes":[{"mesh":0}],"images":[{"uri":"gone.png","name":"moss"}])"));
    CHECK(scene.skipped.at("unused_pictures") == 1);
    CHECK(scene.skipped.count("textures") == 0);
    REQUIRE(scene.warnings.size() == 1);
    CHECK(scene.warnings[0].starts_with("unused picture 0 ('moss')"));
}

TEST_CASE("a hit's geometry is the primitive's index in its mesh, whatever precedes it") {
    GlbWriter writer;
    const std::string position =
        std::to_string(writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3));
    const auto primitive = [&](int mode) {
        return R"({"attributes":{"POSITION":)" + position + R"(},"mode":)" + std::to_string(mode) +
               "}";
    };
    const auto scene = must_describe(writer.glb(R"("meshes":[{"primitives":[)" + primitive(1) +
                                                "," + primitive(4) + "," + primitive(0) +
                                                R"(]}],"nodes":[{"mesh":0}])"));
    const auto& geometries = scene.objects[0].geometries;
    REQUIRE(geometries.size() == 3);
    CHECK(geometries[0].indices.empty());
    CHECK(geometries[1].indices.size() == 3);
    const auto snapshot = Snapshot::build(scene);
    REQUIRE_MESSAGE(snapshot.has_value(), (snapshot ? "" : snapshot.error().message));
    const SceneView& view = (*snapshot)->view();
    const ObjectRecord& object = view.objects[0];
    CHECK(&view.geometry_of(object, 0) == view.geometries + object.first_geometry + 1);
}

TEST_CASE("only the chosen scene is placed") {
    GlbWriter writer;
    const std::string mesh =
        one_triangle_mesh(writer) + R"(,"nodes":[{"mesh":0},{"mesh":0},{"mesh":0}])";
    CHECK(must_describe(writer.glb(mesh)).objects.back().instances.size() == 3);
    const std::string scenes = R"(,"scenes":[{"nodes":[0]},{"nodes":[1,2]}])";
    CHECK(must_describe(writer.glb(mesh + scenes)).objects.back().instances.size() == 1);
    CHECK(
        must_describe(writer.glb(mesh + scenes + ",\"scene\":1")).objects.back().instances.size() ==
        2);
    const auto twice = must_describe(writer.glb(mesh + R"(,"scenes":[{"nodes":[1,1]}])"));
    CHECK(twice.objects.back().instances.size() == 1);
    CHECK(twice.warnings.size() == 1);
}

TEST_CASE("more data than a small file can hold is refused before it costs memory") {
    GlbWriter writer;
    writer.add_floats(std::vector<float>(30000, 1.0F), "VEC3", 3);
    std::string primitives;
    for (int i = 0; i < 2000; ++i) primitives += R"({"attributes":{"POSITION":0}},)";
    primitives.pop_back();
    CHECK(contains(refusal(writer.glb("\"meshes\":[{\"primitives\":[" + primitives +
                                      "]}],\"nodes\":[{\"mesh\":0}]")),
                   "repeatedly"));

    std::string empty_nodes = "{}";
    for (int i = 0; i < 100000; ++i) empty_nodes += ",{}";
    CHECK(contains(refusal(GlbWriter().glb("\"nodes\":[" + empty_nodes + "]")), "objects in its"));

    GlbWriter instanced;
    const std::string mesh = one_triangle_mesh(instanced);
    const int places = instanced.add_floats(std::vector<float>(30000, 1.0F), "VEC3", 3);
    std::string nodes;
    for (int i = 0; i < 300; ++i) {
        nodes +=
            R"({"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":)" +
            std::to_string(places) + "}}}},";
    }
    nodes.pop_back();
    CHECK(contains(refusal(instanced.glb(mesh + ",\"nodes\":[" + nodes + "]")), "instances"));
}

TEST_CASE("a refusal names the faulty element and its fault, not a consequence") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    CHECK(contains(refusal(writer.glb(mesh + R"(,"nodes":[{"mesh":0,"children":[0]}])")),
                   "node 0 is its own child"));

    // Read as floats, three 16-bit indices also reach beyond their bufferView.
    GlbWriter floats;
    floats.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    floats.add<std::uint16_t>({0, 1, 2}, "SCALAR", 5126, 1);
    CHECK(contains(
        refusal(floats.glb(R"("nodes":[{"mesh":0}],"meshes":[{"primitives":[
                       {"attributes":{"POSITION":0},"indices":1}]}])")),
        "mesh 0 needs accessor 1, which holds indices that are not plain unsigned integers"));
}

TEST_CASE("an import that fails names its file") {
    const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const test::Upload upload("sub/town.glb", test::to_bytes("glTF"));
    const auto scene = import_here(upload.request(), ImportLimits{}, **registry);
    REQUIRE_FALSE(scene.has_value());
    CHECK(contains(scene.error().message, "sub/town.glb: the GLB file"));
}

TEST_CASE("a chain of a hundred thousand nodes is traversed without recursion") {
    GlbWriter writer;
    const std::string mesh = one_triangle_mesh(writer);
    std::string nodes;
    constexpr int count = 100000;
    for (int i = 0; i + 1 < count; ++i) {
        nodes += "{\"name\":\"n\",\"children\":[" + std::to_string(i + 1) + "]},";
    }
    nodes += "{\"mesh\":0}";
    const auto scene = must_describe(writer.glb(mesh + ",\"nodes\":[" + nodes + "]"));
    CHECK(scene.objects[scene.root].instances.size() == 1);
    CHECK(scene.path_nodes.size() == count + 1);
}

TEST_CASE("a scene reads the files that came with it, and no others") {
    GlbWriter writer;
    const std::string triangle(36, '\0');
    const auto gltf = [](const std::string& uri) {
        return test::to_bytes(
            R"({"asset":{"version":"2.0"},"buffers":[{"byteLength":36,"uri":")" + uri +
            R"("}],"bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{"bufferView":0,
            "componentType":5126,"count":3,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":
            {"POSITION":0}}]}],"nodes":[{"mesh":0}]})");
    };
    const auto load = [&](const std::string& uri, const std::string& uploaded) {
        test::Upload upload("scene.gltf", gltf(uri));
        upload.add(uploaded, test::to_bytes(triangle));
        return describe_gltf(upload.request(), ImportLimits{}).has_value();
    };
    CHECK(load("a.bin", "a.bin"));
    CHECK(load("./a.bin", "a.bin"));
    CHECK(load("x/../a.bin", "a.bin"));
    CHECK(load("sub/a%20b.bin", "sub/a b.bin"));
    CHECK_FALSE(load("b.bin", "a.bin"));

    // Plant secrets of the right length at every place that a careless reader would open.
    const auto folder = std::filesystem::temp_directory_path() / "raynest-planted-secret";
    std::filesystem::create_directories(folder / "inner");
    const auto before = std::filesystem::current_path();
    for (const auto& place : {folder / "secret.bin", folder / "inner" / "secret.bin"}) {
        std::ofstream(place, std::ios::binary) << triangle;
    }
    std::filesystem::current_path(folder / "inner");
    const std::string absolute = (folder / "secret.bin").string();
    for (const std::string& uri :
         {std::string("secret.bin"), std::string("../secret.bin"), std::string("%2e%2e/secret.bin"),
          std::string("..%2fsecret.bin"), std::string("%2E%2E%2Fsecret.bin"),
          "x/../../secret.bin" + std::string(), absolute, "/" + absolute, "file://" + absolute,
          std::string("..%5csecret.bin"), std::string("%252e%252e/secret.bin")}) {
        CAPTURE(uri);
        CHECK_FALSE(load(uri, "other.bin"));
        // Even a file that was uploaded under such a name is not read.
        if (uri != "secret.bin") CHECK_FALSE(load(uri, uri));
    }
    std::filesystem::current_path(before);
    std::filesystem::remove_all(folder);
}
