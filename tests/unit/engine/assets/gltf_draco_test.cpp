// KHR_draco_mesh_compression: streams of Draco's encoder are decoded, and damaged ones refused.
#include "engine/assets/gltf/file/draco.h"
#include "tests/unit/engine/assets/describe.h"
#include "tests/unit/engine/assets/draco_streams.h"

#include <algorithm>
#include <random>

using namespace raynest;
using gltf::Component;
using test::contains;
using test::GlbWriter;

namespace {

using Stream = std::vector<unsigned char>;

const std::vector<float> quad{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};

const Stream sequential(std::begin(test::draco_sequential), std::end(test::draco_sequential));
const Stream edgebreaker(std::begin(test::draco_edgebreaker), std::end(test::draco_edgebreaker));
const Stream shaded(std::begin(test::draco_shaded), std::end(test::draco_shaded));
const Stream skinned(std::begin(test::draco_skinned), std::end(test::draco_skinned));

/// True if this build has Draco; prints a message if not.
bool have_draco() {
    const auto available = gltf::draco_available();
    if (!available) MESSAGE("skipped: ", available.error().message);
    return available.has_value();
}

Result<gltf::DracoMesh> decode(const Stream& stream, std::uint64_t bytes_max = 1 << 20,
                               std::uint32_t id = 0, Component component = Component::f32,
                               std::uint32_t width = 3) {
    const gltf::DracoAttribute wanted{id, component, width};
    return gltf::decode_draco(std::as_bytes(std::span(stream)), std::span(&wanted, 1), bytes_max);
}

template <class T>
std::vector<T> values_of(const std::vector<unsigned char>& bytes) {
    std::vector<T> values(bytes.size() / sizeof(T));
    std::memcpy(values.data(), bytes.data(), bytes.size());
    return values;
}

/// A scene whose accessors hold zeros, which Draco's data replace.
class CompressedScene {
public:
    GlbWriter writer;
    std::string attributes;
    std::string ids;

    void add(const char* name, int id, int accessor) {
        for (auto [text, value] : {std::pair(&attributes, accessor), std::pair(&ids, id)}) {
            if (!text->empty()) *text += ',';
            *text += std::string("\"") + name + "\":" + std::to_string(value);
        }
    }
    [[nodiscard]] test::Bytes glb(const Stream& stream, const std::string& rest,
                                  const std::string& more = {}) {
        const int indices = writer.add_indices({0, 0, 0});
        const int view = writer.add(stream, "SCALAR", 5121, 1);
        return writer.glb(R"("extensionsRequired":["KHR_draco_mesh_compression"],
            "meshes":[{"primitives":[{"attributes":{)" +
                          attributes + "},\"indices\":" + std::to_string(indices) + more +
                          R"(,"extensions":{"KHR_draco_mesh_compression":{"bufferView":)" +
                          std::to_string(view) + ",\"attributes\":{" + ids + "}}}}]}]," + rest);
    }
};

CompressedScene quad_scene() {
    CompressedScene scene;
    scene.add("POSITION", 0, scene.writer.add_floats(std::vector<float>(12, 0), "VEC3", 3));
    return scene;
}

}  // namespace

TEST_CASE("Draco's sequential and edgebreaker meshes come back as they were encoded") {
    if (!have_draco()) return;
    const auto mesh = decode(sequential);
    REQUIRE_MESSAGE(mesh.has_value(), (mesh ? "" : mesh.error().message));
    CHECK(mesh->points == 4);
    CHECK(values_of<std::uint32_t>(mesh->indices) == std::vector<std::uint32_t>{0, 1, 2, 2, 1, 3});
    CHECK(values_of<float>(mesh->attributes[0]) == quad);

    // Edgebreaker reorders points and faces.
    const auto turned = decode(edgebreaker);
    REQUIRE(turned.has_value());
    CHECK(turned->points == 4);
    CHECK(turned->indices.size() == 24);
    auto values = values_of<float>(turned->attributes[0]);
    auto expected = quad;
    std::sort(values.begin(), values.end());
    std::sort(expected.begin(), expected.end());
    CHECK(values == expected);
}

TEST_CASE("a Draco scene shows its compressed data, as triangles, and not its fallback") {
    if (!have_draco()) return;
    for (const char* mode : {"", ",\"mode\":5"}) {
        const auto scene =
            test::must_describe(quad_scene().glb(sequential, R"("nodes":[{"mesh":0}])", mode));
        const GeometryDescription& geometry = scene.objects[0].geometries[0];
        CHECK(geometry.positions == std::vector<Vec3>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}});
        CHECK(geometry.indices == std::vector<std::uint32_t>{0, 1, 2, 2, 1, 3});
    }
}

TEST_CASE("a Draco mesh may be skinned and morphed") {
    if (!have_draco()) return;
    CompressedScene scene = quad_scene();
    scene.add("JOINTS_0", 1, scene.writer.add(std::vector<std::uint8_t>(16, 0), "VEC4", 5121, 4));
    scene.add("WEIGHTS_0", 2, scene.writer.add_floats(std::vector<float>(16, 0), "VEC4", 4));
    const int target = scene.writer.add_floats({0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1}, "VEC3", 3);
    const auto described = test::must_describe(
        scene.glb(skinned,
                  R"("skins":[{"joints":[1,2]}],"nodes":[{"mesh":0,"skin":0,"weights":[2]},
        {"translation":[10,0,0]},{"translation":[20,0,0]}])",
                  ",\"targets\":[{\"POSITION\":" + std::to_string(target) + "}]"));
    const auto& instance = described.objects[described.root].instances[0];
    CHECK(described.objects[instance.object].geometries[0].positions ==
          std::vector<Vec3>{{10, 0, 2}, {11, 0, 2}, {15, 1, 2}, {21, 1, 2}});
}

TEST_CASE("every attribute that is read from plain geometry is read from Draco's") {
    if (!have_draco()) return;
    CompressedScene scene = quad_scene();
    const auto add = [&](const char* name, int id, const char* type, std::size_t width) {
        scene.add(name, id, scene.writer.add_floats(std::vector<float>(4 * width, 0), type, width));
    };
    add("NORMAL", 1, "VEC3", 3);
    add("TANGENT", 2, "VEC4", 4);
    add("TEXCOORD_0", 3, "VEC2", 2);
    add("TEXCOORD_1", 4, "VEC2", 2);
    add("COLOR_0", 5, "VEC4", 4);
    const auto described = test::must_describe(
        scene.glb(shaded,
                  R"("images":[{"uri":"data:image/png;base64,AA=="}],"textures":[{"source":0}],
        "materials":[{"normalTexture":{"index":0}}],"nodes":[{"mesh":0}])",
                  ",\"material\":0"));
    const GeometryDescription& geometry = described.objects[0].geometries[0];
    CHECK(geometry.normals ==
          std::vector<Vec3>{{0, 0, 1}, {0.6F, 0, 0.8F}, {0, 0.6F, 0.8F}, {-0.6F, 0, 0.8F}});
    CHECK(geometry.tangents ==
          std::vector<Vec4>{{1, 0, 0, 1}, {1, 0, 0, 1}, {0, 1, 0, -1}, {0, 1, 0, -1}});
    CHECK(geometry.texcoords[0] == std::vector<Vec2>{{0, 0}, {1, 0}, {0, 1}, {1, 1}});
    CHECK(geometry.texcoords[1] == std::vector<Vec2>{{2, 0}, {3, 0}, {2, 1}, {3, 1}});
    CHECK(geometry.colours == std::vector<std::uint8_t>{255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255,
                                                        255, 255, 255, 255, 0});

    // THE LIST is that of both: none of its attributes is missing above, or in the skinned test.
    gltf::Primitive primitive;
    primitive.joint_sets.resize(1);
    std::vector<std::string> names;
    for (const auto& attribute : gltf::attributes_of(primitive)) names.push_back(attribute.name);
    CHECK(names == std::vector<std::string>{"POSITION", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0",
                                            "NORMAL", "TANGENT", "JOINTS_0", "WEIGHTS_0"});
}

TEST_CASE("Draco data that does not fit its accessors is refused by name") {
    if (!have_draco()) return;
    const Stream& stream = sequential;
    const auto message = [](const Result<gltf::DracoMesh>& mesh) {
        REQUIRE_FALSE(mesh.has_value());
        return mesh.error().message;
    };
    CHECK(contains(message(decode({})), "Draco data that is no Draco stream"));
    Stream other = edgebreaker;
    other[0] = 'X';
    CHECK(contains(message(decode(other)), "Draco data that is no Draco stream"));
    CHECK(contains(message(decode(Stream(36, 0))), "Draco"));
    CHECK(contains(message(decode(stream, 1 << 20, 7)), "without attribute 7"));
    CHECK(contains(message(decode(stream, 1 << 20, 0, Component::f32, 2)), "3 components"));
    CHECK(contains(message(decode(stream, 10)), "far more than valid data"));
    CHECK(contains(message(decode(stream, 50)), "far more than valid data"));

    const auto nowhere = test::refusal([] {
        CompressedScene scene = quad_scene();
        scene.ids = "\"POSITION\":99";
        return scene.glb(sequential, R"("nodes":[{"mesh":0}])");
    }());
    CHECK(contains(nowhere, "mesh 0 has Draco data without attribute 99"));
    CHECK(contains(test::refusal(quad_scene().glb(Stream(50, 1), R"("nodes":[{"mesh":0}])")),
                   "mesh 0 has Draco data"));
}

TEST_CASE("a Draco header that declares millions of faces is refused before they are allocated") {
    if (!have_draco()) return;
    for (Stream stream : {sequential, edgebreaker}) {
        // The number of faces is the varint after the header of 11 bytes, or after traversal and
        // number of vertices.
        const std::size_t at = stream == sequential ? 11 : 13;
        REQUIRE(stream[at] == 2);
        stream[at] = 0xFF;
        stream.insert(stream.begin() + static_cast<std::ptrdiff_t>(at) + 1, {0xFF, 0xFF, 0x3F});
        const auto mesh = decode(stream);
        REQUIRE_FALSE(mesh.has_value());
        CHECK(mesh.error().code == ErrorCode::limit_exceeded);
    }
}

TEST_CASE("damaged Draco streams end in an error or in some numbers") {
    if (!have_draco()) return;
    std::mt19937 random(6);
    for (const Stream& whole : {sequential, edgebreaker, skinned, shaded}) {
        for (std::size_t cut = 0; cut < whole.size(); ++cut) {
            const auto end = whole.begin() + static_cast<std::ptrdiff_t>(cut);
            const auto mesh = decode(Stream(whole.begin(), end));
            if (cut < 16) CHECK_FALSE(mesh.has_value());
        }
        for (int round = 0; round < 1000; ++round) {
            Stream stream = whole;
            stream[random() % stream.size()] = static_cast<unsigned char>(random());
            const auto mesh = decode(stream);
            if (mesh) CHECK(mesh->indices.size() <= 1 << 20);
        }
    }
}
