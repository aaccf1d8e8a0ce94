#include "engine/assets/sandbox/import_child.h"

#include "engine/assets/builtin/builtin.h"
#include "engine/assets/import.h"
#include "engine/assets/sandbox/import_wire.h"
#include "engine/assets/sandbox/sandbox.h"
#include "engine/system/child_process.h"
#include "tests/patience.h"
#include "tests/sanitized.h"
#include "tests/temporary_folder.h"
#include "tests/unit/engine/assets/describe.h"
#include "tests/unit/engine/assets/forbidden_calls.h"
#include "tests/unit/engine/assets/samples.h"
#include "tests/unit/engine/assets/test_child.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <thread>

using namespace raynest;
using test::child;
namespace fs = std::filesystem;

namespace {

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

std::string refusal(const std::vector<std::string>& command, const ImportLimits& limits = {}) {
    const auto scene = import_in_child(builtin("builtin:flake?depth=2"), limits, command);
    REQUIRE_FALSE(scene.has_value());
    return scene.error().message;
}

std::string refusal(const char* mode, const ImportLimits& limits = {}) {
    return refusal(child(mode), limits);
}

/// Names the forbidden call that a child was not refused; empty if it was refused all.
std::string not_refused(const char* mode) {
    const std::string message = refusal(mode);
    for (std::size_t i = 0; i <= test::forbidden_calls().size(); ++i)
        if (message.ends_with(fmt::format("exit code {}", 100 + i)))
            return i == 0 ? "" : std::string(test::forbidden_calls()[i - 1].name);
    return message;
}

}  // namespace

TEST_CASE("the child makes the same snapshot as this process") {
    const auto registry = Registry::load({});
    REQUIRE(registry.has_value());
    const ImportRequest request = builtin("builtin:forest?trees=20");
    const auto here = import_here(request, ImportLimits{}, **registry, describe_builtin);
    const auto there = import(request);
    REQUIRE(here.has_value());
    REQUIRE_MESSAGE(there.has_value(), (there ? "" : there.error().message));
    CHECK((*here)->digest() == (*there)->digest());
    // Without them an import knows files alone.
    const auto none = import_here(request, ImportLimits{}, **registry);
    REQUIRE_FALSE(none.has_value());
    CHECK(none.error().message.find("pass describe_builtin()") != std::string::npos);
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
    const auto scene = import_in_child(builtin("builtin:flake"), {}, child("--hang"),
                                       [&](std::uint64_t) { return ++asked < 3; });
    REQUIRE_FALSE(scene.has_value());
    CHECK(scene.error().message.find("abandoned") != std::string::npos);
    CHECK(asked == 3);
}

TEST_CASE("the caller is told how much memory a child holds, and can end one that takes too much") {
    const ImportRequest request = builtin("builtin:terrain?size=200");
    std::uint64_t most = 0;
    const auto scene =
        import_in_child(request, {}, child("--import-child"), [&](std::uint64_t bytes) {
            most = std::max(most, bytes);
            return true;
        });
    REQUIRE(scene.has_value());
    CHECK(most > (*scene)->bytes().size());
    const auto ended = import_in_child(request, {}, child("--import-child"),
                                       [&](std::uint64_t bytes) { return bytes < most / 2; });
    REQUIRE_FALSE(ended.has_value());
    CHECK(ended.error().message.find("abandoned") != std::string::npos);
}

TEST_CASE("a child whose memory cannot be read is stopped") {
    const std::string said = refusal("--without-proc");
    if (said.ends_with("exit code 102"))
        MESSAGE("skipped: /proc cannot be covered here");
    else
        CHECK(said.ends_with("exit code 100"));
}

TEST_CASE("a child reads nothing before its parent can measure it") {
    const Fd request = create_memory_file("request").value();
    const Fd result = create_memory_file("result").value();
    REQUIRE(wire::write_request(request.get(), wire::Work::scene, builtin("builtin:flake?depth=2"),
                                {}));
    struct flock whole {};
    whole.l_type = F_WRLCK;
    REQUIRE(::fcntl(request.get(), F_SETLK, &whole) == 0);
    const auto pid = spawn_child(child(), std::array{request.get(), result.get()}).value();
    const auto has_ended = [&] {
        siginfo_t state{};
        return ::waitid(P_PID, static_cast<id_t>(pid), &state, WEXITED | WNOHANG | WNOWAIT) == 0 &&
               state.si_pid != 0;
    };
    std::this_thread::sleep_for(std::chrono::seconds(1));
    CHECK_FALSE(has_ended());
    whole.l_type = F_UNLCK;
    REQUIRE(::fcntl(request.get(), F_SETLK, &whole) == 0);
    CHECK(test::eventually(has_ended));
    CHECK(end_group(pid) == 0);
    CHECK(wire::read_result(result.get(), 1 << 30));
}

TEST_CASE("a scene larger than allowed is not read, whatever the child claims") {
    ImportLimits limits;
    const auto scene = import(builtin("builtin:flake?depth=2"), "--boundless", limits);
    REQUIRE(scene.has_value());
    limits.scene_bytes_max = (*scene)->bytes().size();
    CHECK(import(builtin("builtin:flake?depth=2"), "--boundless", limits).has_value());
    --limits.scene_bytes_max;
    CHECK(refusal("--boundless", limits).find("incomplete result") != std::string::npos);
    CHECK(refusal("--import-child", limits).find("MiB, more than is free") != std::string::npos);
}

TEST_CASE("what a result takes here is asked for before it is read, whatever it took the child") {
    std::uint64_t most = 0;
    const auto answer = [&](std::uint64_t bytes_max) {
        const auto scene = import_in_child(builtin("builtin:flake"), {}, child("--holes"),
                                           [&](std::uint64_t bytes) {
                                               most = std::max(most, bytes);
                                               return bytes <= bytes_max;
                                           });
        REQUIRE_FALSE(scene.has_value());
        return scene.error().message;
    };
    CHECK(answer(~std::uint64_t{0}).find("RNSCENE") != std::string::npos);
    CHECK(most > 256 << 20);
    CHECK(answer(256 << 20).find("abandoned") != std::string::npos);
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
    // No new privileges, not dumpable, few files, limits on output, processor and memory, the first
    // to end when memory runs out, and no capabilities.
    const int all = test::sanitized ? 255 - 32 : 255;
    CHECK(refusal("--report-limits").find(fmt::format("exit code {}", all)) != std::string::npos);
}

TEST_CASE("nothing is left out of the sandbox here") {
    CHECK(sandbox_gaps().empty());
}

TEST_CASE("after an import the child is refused every call that an attacker would try") {
    if (test::sanitized) return;
    CHECK(not_refused("--hijacked") == "");
}

TEST_CASE("the filter of calls refuses them without Landlock, but the reading of files") {
    if (test::sanitized) return;
    CHECK(not_refused("--calls") == "openat of a secret");
    // A kernel that is built without calls of i386 ends the child by itself.
    const std::string said = refusal("--other-architecture");
    CHECK((said.find("Bad system call") != std::string::npos ||
           said.find("Segmentation fault") != std::string::npos));
}

TEST_CASE("Landlock refuses files, connections, signals and programs without the filter") {
    if (test::sanitized) return;
    const test::TemporaryFolder folder;
    folder.write("victim", "secret");
    CHECK(refusal({RAYNEST_TEST_IMPORT_CHILD, "--files", folder.path().string()})
              .ends_with("exit code 100"));
}

TEST_CASE("the child keeps nothing of the daemon's environment") {
    if (test::sanitized) return;
    REQUIRE(::setenv("RAYNEST_TEST_SECRET", "secret", 1) == 0);
    CHECK(refusal("--environment").ends_with("exit code 100"));
    CHECK(::unsetenv("RAYNEST_TEST_SECRET") == 0);
}

TEST_CASE("the child cannot change or grow its request") {
    CHECK(refusal("--change-request").ends_with("exit code 100"));
}

TEST_CASE("a child that starts many threads is stopped") {
    CHECK(refusal("--threads").find("threads and was stopped") != std::string::npos);
}

TEST_CASE("what a child has started ends with it") {
    const test::TemporaryFolder folder;
    const std::string lock = folder.file("lock");
    CHECK(refusal({RAYNEST_TEST_IMPORT_CHILD, "--leave-a-process", lock}).ends_with("exit code 7"));
    const Fd held(::open(lock.c_str(), O_RDWR));
    REQUIRE(held.get() >= 0);
    CHECK(test::eventually([&] { return ::flock(held.get(), LOCK_EX | LOCK_NB) == 0; }));
}

TEST_CASE("a limit on memory ends in an error that names it") {
    if (!limits_bite()) return;
    CHECK(does_not_fit(256ULL << 20));
}

TEST_CASE("a scene comes with its pictures or not at all, however little memory there is") {
    if (!test::have_images() || !limits_bite()) return;
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
