#include "engine/assets/gltf/file/uri.h"
#include "engine/assets/gltf/gltf.h"
#include "engine/assets/input/messages.h"
#include "tests/unit/engine/assets/samples.h"

#include <nlohmann/json.hpp>

using namespace raynest;

namespace {

const std::string tree = "\xE6\xA3\xAE";  // a forest in Japanese: one character

std::string trees(int count) {
    std::string text;
    while (count-- > 0) text += tree;
    return text;
}

}  // namespace

TEST_CASE("a URI may only name a file beside or below the scene") {
    std::ifstream table(RAYNEST_SOURCE_DIR "/tests/golden/gltf_uris.json");
    const auto cases = nlohmann::json::parse(table);
    REQUIRE(cases.size() > 40);
    for (const auto& entry : cases) {
        const auto uri = entry[0].get<std::string>();
        CAPTURE(uri);
        const auto name = gltf::file_of_uri(uri);
        if (entry[1].is_null())
            CHECK_FALSE(name.has_value());
        else
            CHECK(name == entry[1].get<std::string>());
    }
    CHECK(gltf::file_of_uri(std::string(1024, 'a')).has_value());
    CHECK_FALSE(gltf::file_of_uri(std::string(1025, 'a')).has_value());
    CHECK_FALSE(gltf::file_of_uri(std::string("a\0b", 3)).has_value());
}

TEST_CASE("text is cut between characters") {
    CHECK(front_of("abc", 2) == "ab");
    for (const std::size_t bytes : {6U, 7U, 8U}) {
        CHECK(front_of(trees(3), bytes) == trees(2));
    }
    CHECK(front_of(trees(3), 9) == trees(3));
    CHECK(one_line(trees(3), 7) == trees(2) + "...");
    CHECK(label("mesh", 7, trees(30)) == "mesh 7 ('" + trees(20) + "...')");
}

TEST_CASE("long names of nodes lose no part of a character") {
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    const test::Upload upload(
        "scene.glb", writer.glb(mesh + R"(,"nodes":[{"name":")" + trees(100) +
                                R"(","children":[1]},{"name":")" + trees(100) + R"(","mesh":0}])"));
    const auto scene = describe_gltf(upload.request(), ImportLimits{});
    REQUIRE(scene.has_value());
    CHECK(scene->path_nodes[1].name == trees(53) + "...");
    CHECK(scene->path_nodes[2].name == trees(53) + "...");
}
