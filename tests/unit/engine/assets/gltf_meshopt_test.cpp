// EXT_meshopt_compression: streams of the library's encoders are decoded, and damaged ones refused.
#include "engine/assets/gltf/file/meshopt.h"
#include "tests/unit/engine/assets/describe.h"

#include <meshoptimizer.h>

#include <cmath>
#include <random>

using namespace raynest;
using gltf::MeshoptView;
using test::contains;

namespace {

using Stream = std::vector<unsigned char>;

template <class T>
Stream encode_attributes(const std::vector<T>& values, std::size_t count) {
    const std::size_t stride = values.size() * sizeof(T) / count;
    Stream out(meshopt_encodeVertexBufferBound(count, stride));
    out.resize(meshopt_encodeVertexBuffer(out.data(), out.size(), values.data(), count, stride));
    return out;
}

Stream encode_triangles(const std::vector<unsigned>& indices, std::size_t vertices) {
    Stream out(meshopt_encodeIndexBufferBound(indices.size(), vertices));
    out.resize(meshopt_encodeIndexBuffer(out.data(), out.size(), indices.data(), indices.size()));
    return out;
}

Stream encode_sequence(const std::vector<unsigned>& indices, std::size_t vertices) {
    Stream out(meshopt_encodeIndexSequenceBound(indices.size(), vertices));
    out.resize(meshopt_encodeIndexSequence(out.data(), out.size(), indices.data(), indices.size()));
    return out;
}

Result<std::vector<unsigned char>> decode(const Stream& stream, std::uint64_t count,
                                          std::uint64_t stride, std::string_view mode,
                                          std::string_view filter = "NONE") {
    const MeshoptView view{std::as_bytes(std::span(stream)), count, stride, mode, filter};
    if (const auto bytes = gltf::meshopt_bytes(view); !bytes)
        return tl::unexpected<Error>(bytes.error());
    return gltf::decode_meshopt(view);
}

template <class T>
std::vector<T> must_decode(const Stream& stream, std::uint64_t count, std::uint64_t stride,
                           std::string_view mode, std::string_view filter = "NONE") {
    const auto bytes = decode(stream, count, stride, mode, filter);
    REQUIRE_MESSAGE(bytes.has_value(), (bytes ? "" : bytes.error().message));
    std::vector<T> values(bytes->size() / sizeof(T));
    std::memcpy(values.data(), bytes->data(), bytes->size());
    return values;
}

std::string refusal_of(const Stream& stream, std::uint64_t count, std::uint64_t stride,
                       std::string_view mode, std::string_view filter = "NONE") {
    const auto bytes = decode(stream, count, stride, mode, filter);
    REQUIRE_FALSE(bytes.has_value());
    return bytes.error().message;
}

/// Returns a scene of two buffers, the streams and a fallback that must not be read, with the
/// bufferViews and accessors that the caller states.
test::Upload two_buffers(const std::vector<Stream>& streams,
                         const std::vector<std::string>& members, const std::string& accessors,
                         const std::string& rest) {
    std::string binary;
    std::string views;
    for (std::size_t i = 0; i < streams.size(); ++i) {
        if (i > 0) views += ',';
        // Only the extension allows strides below 4.
        const bool both = !contains(members[i], "\"byteStride\":2");
        views += R"({"buffer":1,"byteLength":4)" + (both ? members[i] : std::string()) +
                 R"(,"extensions":{"EXT_meshopt_compression":{"buffer":0,"byteOffset":)" +
                 std::to_string(binary.size()) +
                 ",\"byteLength\":" + std::to_string(streams[i].size()) + members[i] + "}}}";
        binary.append(streams[i].begin(), streams[i].end());
    }
    test::Upload upload(
        "scene.gltf",
        test::to_bytes(
            R"({"asset":{"version":"2.0"},"extensionsRequired":["EXT_meshopt_compression"],
            "buffers":[{"uri":"s.bin","byteLength":)" +
            std::to_string(binary.size()) +
            R"(},{"uri":"f.bin","byteLength":4,"extensions":{"EXT_meshopt_compression":
            {"fallback":true}}}],"bufferViews":[)" +
            views + R"(],"accessors":[)" + accessors + "]," + rest + "}"));
    upload.add("s.bin", test::to_bytes(binary));
    upload.add("f.bin", test::to_bytes("none"));
    return upload;
}

const std::vector<float> quad{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
const std::vector<unsigned> quad_triangles{0, 1, 2, 2, 1, 3};
const std::string quad_mesh =
    R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],"nodes":[{"mesh":0}])";
const std::string quad_accessors =
    R"({"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},
       {"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"})";
const std::vector<std::string> quad_views{R"(,"byteStride":12,"count":4,"mode":"ATTRIBUTES")",
                                          R"(,"byteStride":2,"count":6,"mode":"TRIANGLES")"};

}  // namespace

TEST_CASE("every meshopt mode comes back as it was encoded") {
    CHECK(must_decode<float>(encode_attributes(quad, 4), 4, 12, "ATTRIBUTES") == quad);
    // Triangles may be rotated, so that their highest corner comes first where that compresses
    // best.
    CHECK(must_decode<std::uint16_t>(encode_triangles(quad_triangles, 4), 6, 2, "TRIANGLES") ==
          std::vector<std::uint16_t>{0, 1, 2, 2, 1, 3});
    CHECK(must_decode<std::uint32_t>(encode_triangles(quad_triangles, 4), 6, 4, "TRIANGLES") ==
          quad_triangles);
    const std::vector<unsigned> strip{0, 1, 2, 3, 70000, 5, 5};
    CHECK(must_decode<std::uint32_t>(encode_sequence(strip, 70001), 7, 4, "INDICES") == strip);
}

TEST_CASE("every meshopt filter restores its input within its precision") {
    const std::vector<float> directions{0, 0.6F, 0.8F, 0, -1, 0, 0, 0, 0.6F, 0, -0.8F, 0};
    for (const std::size_t stride : {4U, 8U}) {
        std::vector<unsigned char> filtered(3 * stride);
        meshopt_encodeFilterOct(filtered.data(), 3, stride, stride == 4 ? 8 : 16,
                                directions.data());
        const Stream stream = encode_attributes(filtered, 3);
        const auto check = [&](const auto& values, float one) {
            for (std::size_t i = 0; i < 12; ++i) {
                CAPTURE(i);
                CHECK(std::abs(static_cast<float>(values[i]) / one - directions[i]) < 0.02F);
            }
        };
        if (stride == 4)
            check(must_decode<std::int8_t>(stream, 3, 4, "ATTRIBUTES", "OCTAHEDRAL"), 127.0F);
        else
            check(must_decode<std::int16_t>(stream, 3, 8, "ATTRIBUTES", "OCTAHEDRAL"), 32767.0F);
    }

    const std::vector<float> rotations{0, 0, 0.6F, 0.8F, 0.5F, 0.5F, 0.5F, 0.5F};
    std::vector<unsigned char> filtered(16);
    meshopt_encodeFilterQuat(filtered.data(), 2, 8, 16, rotations.data());
    const auto turned =
        must_decode<std::int16_t>(encode_attributes(filtered, 2), 2, 8, "ATTRIBUTES", "QUATERNION");
    for (std::size_t i = 0; i < 8; ++i)
        CHECK(std::abs(static_cast<float>(turned[i]) / 32767.0F - rotations[i]) < 0.001F);

    filtered.resize(48);
    meshopt_encodeFilterExp(filtered.data(), 4, 12, 16, quad.data());
    const auto points =
        must_decode<float>(encode_attributes(filtered, 4), 4, 12, "ATTRIBUTES", "EXPONENTIAL");
    for (std::size_t i = 0; i < 12; ++i) CHECK(std::abs(points[i] - quad[i]) < 0.001F);
}

TEST_CASE("a compressed scene shows its compressed data, and not its fallback") {
    const auto upload =
        two_buffers({encode_attributes(quad, 4), encode_triangles(quad_triangles, 4)}, quad_views,
                    quad_accessors, quad_mesh);
    const auto scene = test::must_describe(describe_gltf(upload.request(), ImportLimits{}));
    const GeometryDescription& geometry = scene.objects[0].geometries[0];
    CHECK(geometry.positions == std::vector<Vec3>{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}});
    CHECK(geometry.indices == std::vector<std::uint32_t>{0, 1, 2, 2, 1, 3});
}

TEST_CASE("compressed positions may be quantised") {
    const std::vector<std::uint16_t> corners{0, 0, 0, 0, 16383, 0, 0, 0, 0, 16383, 0, 0};
    const auto upload = two_buffers(
        {encode_attributes(corners, 3)}, {R"(,"byteStride":8,"count":3,"mode":"ATTRIBUTES")"},
        R"({"bufferView":0,"componentType":5123,"count":3,"type":"VEC3"})",
        R"("extensionsUsed":["KHR_mesh_quantization"],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0,"scale":[6.103888e-05,6.103888e-05,6.103888e-05]}])");
    const auto scene = test::must_describe(describe_gltf(upload.request(), ImportLimits{}));
    const Vec3 corner = scene.objects[scene.root].instances[0].transform.point(
        scene.objects[0].geometries[0].positions[1]);
    CHECK(corner.x == doctest::Approx(1).epsilon(1e-5));
}

TEST_CASE("meshopt data that is not allowed is refused before it costs anything") {
    const Stream stream = encode_attributes(quad, 4);
    CHECK(contains(refusal_of(stream, 4, 12, "NOTHING"), "unknown meshopt mode"));
    for (const std::uint64_t stride : {0U, 2U, 6U, 260U})
        CHECK(contains(refusal_of(stream, 4, stride, "ATTRIBUTES"), "bytes each"));
    for (const std::uint64_t stride : {0U, 1U, 8U})
        CHECK(contains(refusal_of(stream, 3, stride, "TRIANGLES"), "bytes each"));
    CHECK(contains(refusal_of(stream, 4, 4, "TRIANGLES"), "4 meshopt elements"));
    CHECK(contains(refusal_of(stream, 0, 4, "ATTRIBUTES"), "0 meshopt elements"));
    CHECK(contains(refusal_of(stream, 4, 12, "ATTRIBUTES", "OCTAHEDRAL"), "do not allow"));
    CHECK(contains(refusal_of(stream, 4, 12, "ATTRIBUTES", "QUATERNION"), "do not allow"));
    CHECK(contains(refusal_of(stream, 4, 12, "ATTRIBUTES", "SOMETHING"), "do not allow"));
    CHECK(contains(refusal_of(stream, 6, 4, "TRIANGLES", "EXPONENTIAL"), "do not allow"));
    for (const std::uint64_t count : {100000ULL, 1ULL << 40, ~0ULL})
        CHECK(contains(refusal_of(stream, count, 12, "ATTRIBUTES"), "cut short or damaged"));
    CHECK(contains(refusal_of(stream, stream.size() * 64 / 12 + 1, 12, "ATTRIBUTES"), "declares"));
    CHECK(contains(refusal_of({}, 4, 12, "ATTRIBUTES"), "cut short or damaged"));
    const Stream cut(stream.begin(), stream.begin() + 8);
    CHECK(contains(refusal_of(cut, 4, 12, "ATTRIBUTES"), "damaged"));
}

TEST_CASE("a stream that many views name counts each time that it is decoded") {
    constexpr std::size_t vertices = 500'000;
    const Stream stream = encode_attributes(std::vector<float>(3 * vertices), vertices);
    const std::string view =
        R"({"buffer":1,"byteLength":4,"extensions":{"EXT_meshopt_compression":{"buffer":0,
        "byteLength":)" +
        std::to_string(stream.size()) + R"(,"byteStride":12,"count":500000,"mode":"ATTRIBUTES"}}})";
    const auto described = [&](int views) {
        std::string list, accessors, primitives;
        for (int i = 0; i < views; ++i) {
            const std::string comma = i == 0 ? "" : ",", number = std::to_string(i);
            list += comma + view;
            accessors += comma + R"({"bufferView":)" + number +
                         R"(,"componentType":5126,"count":3,"type":"VEC3"})";
            primitives += comma + R"({"attributes":{"POSITION":)" + number + "}}";
        }
        test::Upload upload(
            "scene.gltf",
            test::to_bytes(
                R"({"asset":{"version":"2.0"},"extensionsRequired":["EXT_meshopt_compression"],"buffers":[{"uri":"s.bin","byteLength":)" +
                std::to_string(stream.size()) +
                R"(},{"byteLength":4,"extensions":{"EXT_meshopt_compression":{"fallback":true}}}],"bufferViews":[)" +
                list + R"(],"accessors":[)" + accessors + R"(],"meshes":[{"primitives":[)" +
                primitives + R"(]}],"nodes":[{"mesh":0}]})"));
        upload.add("s.bin", test::to_bytes(std::string(stream.begin(), stream.end())));
        return describe_gltf(upload.request(), ImportLimits{});
    };
    CHECK(described(2).has_value());
    const auto refused = described(12);
    REQUIRE_FALSE(refused.has_value());
    CHECK(contains(refused.error().message, "names the same data repeatedly"));
}

TEST_CASE("damaged meshopt streams end in an error or in some numbers") {
    std::mt19937 random(5);
    const Stream attributes = encode_attributes(quad, 4);
    const Stream triangles = encode_triangles(quad_triangles, 4);
    for (int round = 0; round < 2000; ++round) {
        for (const bool is_index : {false, true}) {
            Stream stream = is_index ? triangles : attributes;
            stream[random() % stream.size()] = static_cast<unsigned char>(random());
            if (round % 4 == 0) stream.resize(random() % stream.size());
            const auto decoded =
                is_index ? decode(stream, 6, 4, "TRIANGLES") : decode(stream, 4, 12, "ATTRIBUTES");
            if (!decoded) CHECK(decoded.error().code == ErrorCode::scene_invalid);
        }
    }
}

TEST_CASE("an invalid meshopt extension is refused by name") {
    const auto refused = [](const std::string& members) {
        const auto upload =
            two_buffers({encode_attributes(quad, 4), encode_triangles(quad_triangles, 4)},
                        {members, quad_views[1]}, quad_accessors, quad_mesh);
        const auto scene = describe_gltf(upload.request(), ImportLimits{});
        REQUIRE_FALSE(scene.has_value());
        return scene.error().message;
    };
    CHECK(contains(refused(R"(,"byteStride":12,"mode":"ATTRIBUTES")"), "bufferView 0"));
    CHECK(contains(refused(R"(,"byteStride":12,"count":-4,"mode":"ATTRIBUTES")"),
                   "missing or invalid numbers"));
    CHECK(contains(refused(R"(,"byteStride":12,"count":4,"mode":7)"), "unknown meshopt mode"));
    CHECK(contains(refused(R"(,"byteStride":12,"count":4,"mode":"ATTRIBUTES","filter":3)"),
                   "do not allow"));
    // Indices of missing vertices are found where all indices are checked.
    const auto upload =
        two_buffers({encode_attributes(quad, 4), encode_triangles({0, 1, 9, 9, 1, 3}, 10)},
                    quad_views, quad_accessors, quad_mesh);
    const auto scene = describe_gltf(upload.request(), ImportLimits{});
    REQUIRE_FALSE(scene.has_value());
    CHECK(contains(scene.error().message, "uses vertex 9 of 4"));
}
