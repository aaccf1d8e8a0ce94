#include "engine/assets/gltf/file/prescan.h"
#include "tests/unit/engine/assets/describe.h"
#include "tests/unit/engine/assets/samples.h"

using namespace raynest;
using gltf::prescan_json;
using test::contains;

namespace {

/// Returns the reason for a refusal, or "" if the text may go on to the loader.
std::string scan(const std::string& json) {
    const auto done = prescan_json(test::to_bytes(json), ImportLimits{});
    return done ? "" : done.error().message;
}

std::string repeated(const std::string& text, int count) {
    std::string all;
    for (int i = 0; i < count; ++i) all += text;
    return all;
}

void put_word(test::Bytes& bytes, std::size_t at, std::uint32_t value) {
    std::memcpy(bytes.data() + at, &value, sizeof value);
}

}  // namespace

TEST_CASE("JSON nests 64 levels deep and no deeper, brackets in strings not counted") {
    CHECK(scan(repeated("[", 64) + repeated("]", 64)).empty());
    CHECK(contains(scan(repeated("[", 65) + repeated("]", 65)), "deeper than 64"));
    CHECK(contains(scan(repeated("{\"a\":", 65) + "0" + repeated("}", 65)), "deeper than 64"));
    CHECK(contains(scan(repeated("[", 3'000'000)), "deeper than 64"));
    CHECK(scan("{\"extras\":\"" + repeated("[{", 1000) + "\"}").empty());
}

TEST_CASE("JSON that is cut, doubled or not JSON is refused at its byte") {
    CHECK(contains(scan("{\"asset\":{"), "damaged at byte"));
    CHECK(contains(scan("{\"n\":1e999}"), "damaged at byte"));
    CHECK(contains(scan("{\"n\":NaN}"), "damaged at byte"));
    CHECK(contains(scan("{\"n\":\"\xFF\"}"), "damaged at byte"));
    CHECK(contains(scan("{\"nodes\":[],\"nodes\":[]}"), "occurs twice"));
    CHECK(scan("{\"a\":{\"n\":1},\"b\":{\"n\":1}}").empty());
}

TEST_CASE("node transforms hold numbers") {
    CHECK(contains(scan(R"({"nodes":[{"translation":["1",2,3]}]})"), "holds a string"));
    CHECK(contains(scan(R"({"nodes":[{"rotation":[null,0,0,1]}]})"), "holds null"));
    CHECK(contains(scan(R"({"nodes":[{"children":[true]}]})"), "holds a boolean"));
    CHECK(scan(R"({"nodes":[{"translation":[1,2,3],"extras":["x",null,true]}]})").empty());
}

TEST_CASE("only a scene whose bytes are all in one binary chunk is read as it is") {
    const auto one_binary = [](const std::string& json) {
        const auto found = prescan_json(test::to_bytes(json), ImportLimits{});
        return found && found->one_binary;
    };
    CHECK(one_binary(R"({"buffers":[{"byteLength":4}],"images":[{"bufferView":0}]})"));
    CHECK_FALSE(one_binary(R"({"buffers":[{"byteLength":4},{"byteLength":4}]})"));
    CHECK_FALSE(one_binary(R"({"buffers":[{"byteLength":4,"uri":"b.bin"}]})"));
    CHECK_FALSE(one_binary(R"({"buffers":[{"byteLength":4}],"images":[{"uri":"a.png"}]})"));
    CHECK_FALSE(one_binary(R"({"buffers":[{"byteLength":0}]})"));
    // Numbers that tinygltf wants as integers are written as such before it sees them.
    for (const char* json : {R"({"nodes":[{"mesh":1.0}]})", R"({"nodes":[{"children":[1.0]}]})",
                             R"({"bufferViews":[{"byteOffset":36.0}]})",
                             R"({"meshes":[{"primitives":[{"attributes":{"POSITION":2.0}}]}]})"})
        CHECK_FALSE(one_binary(json));
    CHECK(one_binary(R"({"nodes":[{"translation":[1.0,2.0,0.5]}],"accessors":[{"min":[0.0]}],
                         "materials":[{"metallicFactor":1.0}]})"));
}

TEST_CASE("a GLB container with false lengths is refused") {
    test::GlbWriter writer;
    const test::Bytes good = writer.glb(test::one_triangle_mesh(writer));
    const auto glb = gltf::open_glb(good);
    REQUIRE(glb.has_value());
    CHECK(glb->binary.size() == 36);
    const std::size_t binary_header = 12 + 8 + glb->json.size();
    CHECK(binary_header + 8 + 36 == good.size());
    struct Lie {
        std::size_t at;
        std::uint32_t value;
    };
    for (const Lie lie :
         {Lie{0, 0x46546C68}, Lie{4, 1}, Lie{4, 3}, Lie{8, 12}, Lie{8, 0xFFFFFFFF},
          Lie{12, 0xFFFFFFFC}, Lie{12, 0}, Lie{16, 0x004E4942}, Lie{binary_header, 0xFFFFFFF0}}) {
        CAPTURE(lie.at);
        CAPTURE(lie.value);
        test::Bytes bad = good;
        put_word(bad, lie.at, lie.value);
        CHECK_FALSE(gltf::open_glb(bad).has_value());
    }
    for (std::size_t length = 0; length < good.size(); ++length) {
        CHECK_FALSE(gltf::open_glb(std::span(good).first(length)).has_value());
    }
}
