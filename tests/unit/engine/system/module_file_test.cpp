// Packs and modules whose files are damaged.
#include "engine/system/module_file.h"

#include "engine/packs/load.h"
#include "engine/packs/registry.h"
#include "engine/system/module.h"
#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>

using namespace raynest;

namespace {

std::string content_of(const std::filesystem::path& file) {
    std::ostringstream text;
    text << std::ifstream(file, std::ios::binary).rdbuf();
    return std::move(text).str();
}

/// Which targets there are depends on the build.
std::filesystem::path some_pack() {
    for (const auto& entry : std::filesystem::directory_iterator(builtin_pack_directory()))
        if (entry.path().filename().string().starts_with("raynest-pack-v")) return entry.path();
    return {};
}

bool contains(const std::string& text, const char* part) {
    return text.find(part) != std::string::npos;
}

}  // namespace

TEST_CASE("a pack or a module that is cut short is an error by name") {
    const test::TemporaryFolder folder;
    const std::string whole = content_of(some_pack());
    REQUIRE(whole.size() > 100'000);
    // A name of its own for each: a file that was loaded stays.
    for (std::size_t part = 0; part < 16; ++part) {
        const std::string name = "part" + std::to_string(part) + ".so";
        folder.write(name, whole.substr(0, whole.size() / 20 * part));
        const std::string file = folder.file(name);
        const auto pack = load_pack(file);
        REQUIRE_FALSE(pack.has_value());
        CHECK(pack.error().code == ErrorCode::pack_invalid);
        CHECK(contains(pack.error().message, ("cannot load the kernel pack " + file).c_str()));
        const auto module =
            load_module({file.c_str(), "nothing", 1 << 20, "pictures need it", "build"});
        REQUIRE_FALSE(module.has_value());
        CHECK(contains(module.error().message, "pictures need it"));
        if (part == 0) continue;
        CHECK(contains(pack.error().message, "it is cut short: it has "));
        CHECK(contains(module.error().message, "it is cut short: it has "));
    }
}

TEST_CASE("a file that is no shared object, or no file, is left to the loader or refused") {
    const test::TemporaryFolder folder;
    folder.write("text.so", "no shared object");
    CHECK(check_module_file(folder.file("text.so")));
    CHECK(check_module_file(folder.file("none.so")));
    CHECK(
        contains(load_pack(folder.file("text.so")).error().message, "cannot load the kernel pack"));
    REQUIRE(mkfifo(folder.file("pipe.so").c_str(), 0600) == 0);
    CHECK(contains(load_pack(folder.file("pipe.so")).error().message, "it is no regular file"));
    // Damaged headers promise segments and tables anywhere.
    std::string odd = content_of(some_pack()).substr(0, 4096);
    for (std::size_t at = 16; at < 400; ++at) {
        std::string wrong = odd;
        wrong[at] = static_cast<char>(wrong[at] ^ 0x80);
        folder.write("odd.so", wrong);
        (void)check_module_file(folder.file("odd.so"));
    }
}
