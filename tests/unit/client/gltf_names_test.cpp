#include "client/files/gltf_names.h"

#include "client/files/obj_names.h"

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

#include <fstream>
#include <string>
#include <vector>

using namespace raynest;
using Names = std::vector<std::string>;

namespace {

/// The names of files; those of pictures behind "picture ".
client::Result<Names> names_of(const std::string& json) {
    const auto files = client::gltf_names(std::as_bytes(std::span(json)));
    if (!files) return tl::unexpected(files.error());
    Names names;
    for (const auto& [name, is_picture] : *files)
        names.push_back((is_picture ? "picture " : "") + name);
    return names;
}

std::string word(std::size_t value) {
    std::string bytes;
    for (int i = 0; i < 4; ++i) bytes += static_cast<char>(value >> (8 * i) & 0xFF);
    return bytes;
}

std::string chunk(const std::string& type, const std::string& data) {
    return word(data.size()) + type + data;
}

std::string glb(const std::string& chunks, std::size_t version = 2) {
    return "glTF" + word(version) + word(12 + chunks.size()) + chunks;
}

bool reads(const std::string& file) {
    return client::gltf_json(std::as_bytes(std::span(file))).has_value();
}

}  // namespace

TEST_CASE("buffers and images name files, nothing else does") {
    const auto names = names_of(R"({
        "asset": {"version": "2.0", "uri": "no"}, "uri": "no", "skins": [{"uri": "no"}],
        "buffers": [{"uri": "a.bin", "extras": {"uri": "no"}}, {"byteLength": 4}],
        "images": [{"name": "x", "uri": "t/leaf%20one.png"}, {"bufferView": 0}, {"uri": "a.bin"},
                   {"uri": "data:image/png;base64,AAAA"}, [{"uri": "no"}]],
        "extras": {"images": [{"uri": "no"}]}})");
    REQUIRE(names);
    CHECK(*names == Names{"a.bin", "picture t/leaf one.png"});
    CHECK(*names_of(R"({"images":[{"uri":"a"},{"uri":"b"}],"buffers":[{"uri":"b"}]})") ==
          Names{"picture a", "b"});
}

TEST_CASE("text that is not a JSON object, or nested too deeply, is refused without recursion") {
    for (const std::string& bad :
         {std::string(), std::string("[]"), std::string("7"), std::string("{"),
          std::string("{\"a\":1e999}"), std::string("{\"a\":\"\xff\"}"), std::string("{} {}"),
          std::string(3000000, '['),
          "{\"a\":" + std::string(100, '[') + std::string(100, ']') + "}"}) {
        const auto names = names_of(bad);
        REQUIRE(!names);
        CHECK(names.error().exit == protocol::Exit::invalid);
    }
    CHECK(names_of("{\"a\":" + std::string(63, '[') + std::string(63, ']') + "}"));
    CHECK(!names_of("{\"a\":" + std::string(64, '[') + std::string(64, ']') + "}"));
}

TEST_CASE("a file that is no glTF says what it is instead") {
    const auto why = [](const std::string& text, bool is_glb = true) {
        return client::why_no_gltf(std::as_bytes(std::span(text)), is_glb);
    };
    const std::string pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:1\n";
    CHECK(why(pointer) == "is a Git LFS pointer, not the file itself: run git lfs pull");
    CHECK(why(pointer, false) == why(pointer));
    CHECK(why("\x89PNG\r\n\x1A\n1234") ==
          "is no GLB file: it begins with the bytes 89 50 4e 47 0d 0a 1a 0a");
    CHECK(why("<!DOCTYPE html>\n<html>") == "is no GLB file: it begins with '<!DOCTYPE html>'");
    CHECK(why("{\"asset\":{}}") ==
          "is no GLB file: it begins with '{\"asset\":{}}'; name a file of JSON .gltf");
    CHECK(why("") == "is empty");
    CHECK(why("x", false).empty());
    CHECK(why(glb("")).empty());
}

TEST_CASE("the client accepts the same URIs as the daemon") {
    std::ifstream table(RAYNEST_SOURCE_DIR "/tests/golden/gltf_uris.json");
    const auto cases = nlohmann::json::parse(table);
    REQUIRE(cases.size() > 40);
    for (const auto& entry : cases) {
        const auto uri = entry[0].get<std::string>();
        CAPTURE(uri);
        const auto name = client::file_of_uri(uri);
        if (entry[1].is_null())
            CHECK(!name);
        else
            CHECK(name == entry[1].get<std::string>());
    }
    CHECK(!client::file_of_uri("%ff"));
    CHECK(client::file_of_uri(std::string(1024, 'a')));
    CHECK(!client::file_of_uri(std::string(1025, 'a')));
    const auto names = names_of(R"({"buffers":[{"uri":"../x"},{"uri":"a/../b"},{"uri":"./b"}]})");
    REQUIRE(names);
    CHECK(*names == Names{"b"});
}

TEST_CASE("a GLB's lengths must add up") {
    const std::string json = chunk("JSON", "{}  ");
    CHECK(reads(glb(json)));
    CHECK(reads(glb(json + chunk(std::string("BIN\0", 4), "abcd"))));
    CHECK(!reads("glTF"));
    CHECK(!reads(glb("")));
    CHECK(!reads(glb(json, 1)));
    CHECK(reads(glb(json) + "x"));
    CHECK(reads(glb(chunk("JSON", "{} "))));
    CHECK(!reads(glb(chunk(std::string("BIN\0", 4), "abcd") + json)));
    CHECK(!reads(glb(word(0xFFFFFFFF) + "JSON{}")));
    CHECK(!reads(glb(json + "abc")));
    const std::string whole = glb(json);
    for (std::size_t size = 4; size < whole.size(); ++size) CHECK(!reads(whole.substr(0, size)));
}

TEST_CASE("names in an OBJ and its MTL files, as all readers of them find them") {
    std::ifstream table(RAYNEST_SOURCE_DIR "/tests/golden/obj_names.json");
    for (const auto& entry : nlohmann::json::parse(table)) {
        const auto text = entry["text"].get<std::string>();
        CAPTURE(text);
        CHECK(client::obj_names(entry["file"].get<std::string>(), std::as_bytes(std::span(text))) ==
              entry["names"].get<std::vector<std::string>>());
    }
}
