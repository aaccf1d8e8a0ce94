// Checks that root:PATH reaches files beneath the folder, and nothing else.
#include "server/store/scene_files.h"
#include "server/store/source_root.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <string>

namespace raynest::server {
namespace {

std::span<const std::byte> bytes_of(const std::string& text) {
    return std::as_bytes(std::span(text));
}

const std::string me = "me";

/// Reads a file directly below the root, or below `folder` there.
Result<std::optional<SourceFile>> read(const test::TemporaryFolder& root, const std::string& path,
                                       std::uint64_t bytes_max, Budget& budget,
                                       const std::string& folder = {}) {
    return read_under_root(root.path(), folder, path, bytes_max, {budget, me});
}

TEST_CASE("a file beneath the root is read whole") {
    Budget budget(1 << 20);
    const test::TemporaryFolder folder;
    folder.write("sub/a.gltf", "content");
    const auto file = read(folder, "sub/a.gltf", 100, budget);
    REQUIRE(file);
    REQUIRE(*file);
    CHECK((*file)->bytes.size() == 7);
    CHECK(read(folder, "sub/../sub/a.gltf", 100, budget)->has_value());
    CHECK(read(folder, "a.gltf", 100, budget, "sub")->has_value());
    CHECK(read(folder, "sub/a.gltf", 6, budget).error().code == ErrorCode::limit_exceeded);
}

TEST_CASE("the bytes of all files of a scene count together") {
    Budget budget(1 << 20);
    const test::TemporaryFolder folder;
    const std::string scene =
        R"({"asset":{"version":"2.0"},"buffers":[{"uri":"a.bin","byteLength":100},{"uri":"b.bin","byteLength":100}]})";
    folder.write("s.gltf", scene);
    folder.write("a.bin", std::string(100, 'a'));
    folder.write("b.bin", std::string(100, 'b'));
    const auto files = [&](std::uint64_t bytes_max) {
        return read_scene(folder.path(), "s.gltf", 10, bytes_max, {budget, me});
    };
    REQUIRE(files(scene.size() + 200));
    CHECK(files(scene.size() + 200)->size() == 3);
    const auto refused = files(scene.size() + 199);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == ErrorCode::limit_exceeded);
}

TEST_CASE("nothing outside of the root is opened, and no message names a folder") {
    Budget budget(1 << 20);
    const test::TemporaryFolder outside;
    outside.write("secret", "secret");
    const test::TemporaryFolder folder;
    folder.write("a", "a");
    std::filesystem::create_directory(folder.path() / "directory");
    std::filesystem::create_symlink(outside.path() / "secret", folder.path() / "link");
    std::filesystem::create_symlink("a", folder.path() / "inner");
    std::filesystem::create_symlink("round", folder.path() / "around");
    std::filesystem::create_symlink("around", folder.path() / "round");
    std::filesystem::create_symlink(folder.path() / "a", folder.path() / "absolute");
    std::filesystem::create_symlink("directory/../../" + folder.path().filename().string() + "/a",
                                    folder.path() / "out_and_in");
    std::filesystem::create_directory_symlink(outside.path(), folder.path() / "linked");
    REQUIRE(mkfifo((folder.path() / "fifo").c_str(), 0600) == 0);

    const std::string sibling = "../" + outside.path().filename().string() + "/secret";
    for (const std::string& path : {std::string(""),
                                    std::string("."),
                                    std::string(".."),
                                    std::string("/etc/passwd"),
                                    std::string("../etc/passwd"),
                                    sibling,
                                    std::string("directory"),
                                    std::string("link"),
                                    std::string("round"),
                                    std::string("absolute"),
                                    std::string("out_and_in"),
                                    std::string("linked/secret"),
                                    std::string("fifo"),
                                    std::string("missing"),
                                    std::string("a\0b", 3),
                                    std::string("a/"),
                                    std::string("/proc/self/environ"),
                                    std::string("~/x"),
                                    std::string("file:///etc/passwd"),
                                    std::string("%2e%2e/x"),
                                    std::string(5000, 'x')}) {
        const auto file = read(folder, path, 100, budget);
        CHECK_FALSE_MESSAGE((file && *file), path);
        if (!file) CHECK(file.error().message.find(folder.path().string()) == std::string::npos);
        const auto below = read(folder, "a", 100, budget, path);
        CHECK_FALSE((below && *below && path != "." && !path.empty()));
    }
    CHECK(read(folder, "inner", 100, budget)->has_value());
    CHECK(read(folder, "link", 100, budget).error().message.find("link leaves the folder") !=
          std::string::npos);
    CHECK(read(folder, "round", 100, budget).error().message.find("in a circle") !=
          std::string::npos);
    CHECK_FALSE(read_under_root({}, {}, "a", 100, {budget, me}));
    const auto refusal = [&](const char* name, const char* below) {
        return read(folder, name, 100, budget, below).error().message;
    };
    CHECK(refusal("x", "..").find("the path leaves --scene-root") != std::string::npos);
    CHECK(refusal("../x", ".").find("the path leaves the scene's folder") != std::string::npos);
    CHECK(refusal("", "odd").find("names no file") != std::string::npos);
}

TEST_CASE("a glTF's files are found by their names, once each, and unsafe ones are left out") {
    const std::string gltf = R"({"buffers":[{"uri":"a.bin"},{"uri":"a.bin"},{"uri":"../x"},
        {"uri":"data:application/octet-stream;base64,AAAA"},{"uri":"/etc/passwd"}],
        "images":[{"uri":"t%20x/leaf.png"},{"name":"uri"}],
        "extras":{"uri":"no.bin","buffers":[{"uri":"no.bin"}]},"nodes":[{"uri":"no.bin"}]})";
    CHECK(named_files("a.gltf", bytes_of(gltf), 9) ==
          std::vector<std::string>{"a.bin", "t x/leaf.png"});
    CHECK(named_files("a.gltf", bytes_of("not json"), 9).empty());
    CHECK(named_files("a.gltf", {}, 9).empty());
    CHECK(named_files("a.glb", bytes_of("glTF" + std::string(40, '\xff')), 9).empty());
    CHECK(named_files("a.gltf", bytes_of(std::string(1'000'000, '[')), 9).empty());
}

TEST_CASE("a scene is read with the files that it names beneath its own folder") {
    Budget budget(1 << 20);
    const test::TemporaryFolder folder;
    folder.write("sub/scene.gltf",
                 R"({"buffers":[{"uri":"./a.bin"},{"uri":"missing.bin"},{"uri":"scene.gltf"}]})");
    folder.write("sub/outside.gltf", R"({"images":[{"uri":"link.bin"}]})");
    folder.write("sub/a.bin", "1234");
    folder.write("other.bin", "secret");
    std::filesystem::create_symlink("../other.bin", folder.path() / "sub/link.bin");
    const auto outside = read_scene(folder.path(), "sub/outside.gltf", 10, 1000, {budget, me});
    REQUIRE_FALSE(outside);
    CHECK(outside.error().message.find("root:sub/link.bin: link leaves") != std::string::npos);
    CHECK_FALSE(read_scene(folder.path(), "sub/none.gltf", 10, 1000, {budget, me}));
    const auto files = read_scene(folder.path(), "sub/scene.gltf", 10, 1000, {budget, me});
    REQUIRE(files);
    REQUIRE(files->size() == 2);
    CHECK((*files)[0].name == "scene.gltf");
    CHECK((*files)[1].name == "a.bin");
    CHECK((*files)[1].bytes.size() == 4);
    CHECK_FALSE(read_scene(folder.path(), "sub/scene.gltf", 2, 1000, {budget, me}));
    const std::uint64_t bytes = (*files)[0].bytes.size() + (*files)[1].bytes.size();
    CHECK(read_scene(folder.path(), "sub/scene.gltf", 10, bytes, {budget, me}));
    CHECK_FALSE(read_scene(folder.path(), "sub/scene.gltf", 10, bytes - 1, {budget, me}));

    // The second file must not count as missing: that would be another scene.
    CHECK(budget.used() == bytes);
    for (const std::uint64_t free : {bytes - 1, std::uint64_t{4}}) {
        Budget tight(free);
        const auto refused = read_scene(folder.path(), "sub/scene.gltf", 10, 1000, {tight, me});
        REQUIRE_FALSE(refused);
        CHECK(refused.error().code == ErrorCode::out_of_memory);
        CHECK(tight.used() == 0);
    }
}

}  // namespace
}  // namespace raynest::server
