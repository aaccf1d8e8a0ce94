#include "engine/assets/import.h"
#include "tests/sanitized.h"
#include "tests/unit/engine/assets/describe.h"
#include "tests/unit/engine/assets/samples.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <thread>

using namespace raynest;
namespace fs = std::filesystem;

namespace {

std::vector<std::string> child(const char* mode = "--import-child") {
    return {RAYNEST_TEST_IMPORT_CHILD, mode};
}

Result<std::shared_ptr<const Snapshot>> import(const ImportRequest& request,
                                               const char* mode = "--import-child",
                                               const ImportLimits& limits = {}) {
    return import_in_child(request, limits, child(mode));
}

ImportRequest builtin(const char* source) {
    ImportRequest request;
    request.source = source;
    return request;
}

/// True if children have a limit on memory; prints a message if not.
bool limits_bite() {
    if (test::sanitized) MESSAGE("skipped: sanitizers need more address space than any limit");
    return !test::sanitized;
}

/// True if a scene is refused whose vertices alone take all of these bytes.
bool does_not_fit(std::uint64_t bytes) {
    const auto side = static_cast<int>(std::sqrt(static_cast<double>(bytes) / sizeof(Vec3)));
    ImportLimits limits;
    limits.bytes_max = bytes;
    const auto scene = import(builtin(fmt::format("builtin:terrain?size={}", side).c_str()),
                              "--import-child", limits);
    return !scene && scene.error().code == ErrorCode::out_of_memory &&
           scene.error().message.find("more memory than an import may take") != std::string::npos;
}

std::string refusal(const char* mode, const ImportLimits& limits = {}) {
    const auto scene = import(builtin("builtin:flake?depth=2"), mode, limits);
    REQUIRE_FALSE(scene.has_value());
    return scene.error().message;
}

}  // namespace

TEST_CASE("the child makes the same snapshot as this process") {
    const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const ImportRequest request = builtin("builtin:forest?trees=20");
    const auto here = import_here(request, ImportLimits{}, **registry);
    const auto there = import(request);
    REQUIRE(here.has_value());
    REQUIRE_MESSAGE(there.has_value(), (there ? "" : there.error().message));
    CHECK((*here)->digest() == (*there)->digest());
}

TEST_CASE("the child's error arrives with its code") {
    const auto scene = import(builtin("builtin:jungle"));
    REQUIRE_FALSE(scene.has_value());
    CHECK(scene.error().code == ErrorCode::scene_invalid);
    CHECK(scene.error().message.find("jungle") != std::string::npos);
}

TEST_CASE("a child that crashes, fails, hangs or answers falsely is an error") {
    CHECK(refusal("--crash").find("ended the import process") != std::string::npos);
    CHECK(refusal("--fail").find("exit code 7") != std::string::npos);
    CHECK(refusal("--killed").find("short of memory") != std::string::npos);
    CHECK(refusal("--junk").find("incomplete result") != std::string::npos);
    CHECK(refusal("--nothing").find("incomplete result") != std::string::npos);
    ImportLimits limits;
    limits.time_max = std::chrono::seconds(1);
    CHECK(refusal("--hang", limits).find("longer than 1 s") != std::string::npos);
    const std::vector<std::string> absent{"/nonexistent/raynestd"};
    CHECK_FALSE(import_in_child(builtin("builtin:flake"), limits, absent).has_value());
}

TEST_CASE("a child whose result is unwanted is killed") {
    int asked = 0;
    const auto scene =
        import_in_child(builtin("builtin:flake"), {}, child("--hang"), [&] { return ++asked < 3; });
    REQUIRE_FALSE(scene.has_value());
    CHECK(scene.error().message.find("abandoned") != std::string::npos);
    CHECK(asked == 3);
}

TEST_CASE("a scene larger than allowed is not read, whatever the child claims") {
    ImportLimits limits;
    const auto scene = import(builtin("builtin:flake?depth=2"), "--boundless", limits);
    REQUIRE(scene.has_value());
    limits.scene_bytes_max = (*scene)->bytes().size();
    CHECK(import(builtin("builtin:flake?depth=2"), "--boundless", limits).has_value());
    --limits.scene_bytes_max;
    CHECK(refusal("--boundless", limits).find("incomplete result") != std::string::npos);
    CHECK(refusal("--import-child", limits).find("MiB are free") != std::string::npos);
}

TEST_CASE("the child inherits only its two files") {
    // 0, 1, 2 are /dev/null, 3 and 4 the memory files; a descriptor without close-on-exec must not
    // pass.
    const int open_here = ::open("/dev/null", O_RDONLY);
    REQUIRE(open_here >= 0);
    CHECK(refusal("--list-descriptors").find("exit code 105") != std::string::npos);
    ::close(open_here);
}

TEST_CASE("the child drops its privileges before it reads a file") {
    // No new privileges, not dumpable, few files, and limits on output, processor and memory.
    const int all = test::sanitized ? 31 : 63;
    CHECK(refusal("--report-limits").find(fmt::format("exit code {}", all)) != std::string::npos);
}

TEST_CASE("the child opens no socket or file and starts no program, but finds its libraries") {
    if (test::sanitized) return;
    CHECK(refusal("--sandbox").find("exit code 100") != std::string::npos);
}

TEST_CASE("a limit on memory ends in an error that names it") {
    if (!limits_bite()) return;
    CHECK(does_not_fit(256ULL << 20));
}

TEST_CASE("a scene comes with its pictures or not at all, however little memory there is") {
    if (!test::have_images()) return;
    test::GlbWriter writer;
    const std::string mesh = test::one_triangle_mesh(writer);
    constexpr std::uint32_t side = 4096;
    const auto picture =
        encode_png(side, side, std::vector<std::uint8_t>(std::size_t{side} * side * 4, 0x55));
    REQUIRE(picture.has_value());
    const int view = writer.add(*picture, "SCALAR", 5121, 1);
    const test::Upload upload("scene.glb", writer.glb(mesh + R"(,"nodes":[{"mesh":0}],
        "images":[{"bufferView":)" + std::to_string(view) +
                                                      R"(,"mimeType":"image/png"}],
        "textures":[{"source":0}],
        "materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}])"));
    bool loaded = false;
    int refused = 0;
    for (std::uint64_t mib = 64; mib <= 1024 && !loaded; mib += 64) {
        CAPTURE(mib);
        ImportLimits limits;
        limits.bytes_max = mib << 20;
        const auto scene = import(upload.request(), "--import-child", limits);
        loaded = scene.has_value();
        if (loaded) CHECK((*scene)->statistics().skipped.count("textures") == 0);
        if (!loaded) CHECK(scene.error().code == ErrorCode::out_of_memory);
        refused += loaded ? 0 : 1;
    }
    CHECK(loaded);
    CHECK((refused > 0 || test::sanitized));
}

TEST_CASE("many imports at once do not disturb each other") {
    const auto expected = import(builtin("builtin:flake?depth=3"));
    REQUIRE(expected.has_value());
    std::vector<std::string> hashes(6);
    {
        std::vector<std::jthread> threads;
        for (std::string& hash : hashes) {
            threads.emplace_back([&hash] {
                const auto scene = import(builtin("builtin:flake?depth=3"));
                hash = scene ? (*scene)->digest() : scene.error().message;
            });
        }
    }
    for (const std::string& hash : hashes) CHECK(hash == (*expected)->digest());
}

TEST_CASE("hostile files take neither five seconds nor 512 MiB from the child" *
          doctest::test_suite("shared scenes")) {
    if (!test::have_shared_scenes()) return;
    ImportLimits limits;
    limits.bytes_max = 512ULL << 20;  // address space, libraries included
    limits.time_max = std::chrono::seconds(5);
    if (limits_bite()) CHECK(does_not_fit(limits.bytes_max));
    for (const auto& entry : fs::directory_iterator(test::shared_scene("hostile"))) {
        const fs::path extension = entry.path().extension();
        if (extension != ".gltf" && extension != ".glb") continue;
        CAPTURE(entry.path().string());
        const test::Upload upload(entry.path());
        const auto scene = import(upload.request(), "--import-child", limits);
        if (scene) continue;
        const Error& error = scene.error();
        CAPTURE(error.message);
        CHECK(error.code != ErrorCode::internal);
        CHECK(error.code != ErrorCode::out_of_memory);
        CHECK(error.message.find("was stopped") == std::string::npos);
    }
}

TEST_CASE("cocoa_temple.glb loads through the child" * doctest::test_suite("shared scenes")) {
    if (!test::have_shared_scenes()) return;
    const test::Upload upload(test::shared_scene("cocoa_temple.glb"));
    const auto scene = import(upload.request());
    REQUIRE_MESSAGE(scene.has_value(), (scene ? "" : scene.error().message));
    CHECK((*scene)->statistics().instances == 1353);
}
