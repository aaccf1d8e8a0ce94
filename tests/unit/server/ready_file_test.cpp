#include "server/options/ready_file.h"

#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

std::ptrdiff_t files_in(const std::filesystem::path& folder) {
    return std::distance(std::filesystem::directory_iterator(folder), {});
}

TEST_CASE("the ready file holds addresses and pid, and no half-written one is left") {
    const test::TemporaryFolder folder;
    const auto path = folder.path() / "ready.json";
    const std::vector<std::string> listen = {"tcp://127.0.0.1:1", "unix:/a b"};
    REQUIRE(write_ready_file(path, listen, "http://127.0.0.1:2"));
    std::ifstream file(path);
    const auto content = nlohmann::json::parse(file);
    CHECK(content["listen"] == nlohmann::json(listen));
    CHECK(content["http"] == "http://127.0.0.1:2");
    CHECK(content["pid"] == getpid());
    CHECK(files_in(folder.path()) == 1);
}

TEST_CASE("a ready file takes the place of an empty file or an older one, and of nothing else") {
    const test::TemporaryFolder folder;
    const auto path = folder.path() / "ready.json";
    const auto put = [&](const std::string& text) { std::ofstream(path) << text; };
    for (const char* text : {"", R"({"listen":["tcp://127.0.0.1:1"],"http":"off","pid":17})"}) {
        CAPTURE(text);
        put(text);
        CHECK(check_ready_file(path));
        CHECK(write_ready_file(path, {}, "off"));
    }
    for (const char* text : {"precious", "{}", "[1]", R"({"listen":[],"http":"off"})",
                             R"({"listen":[],"http":"off","pid":1,"more":2})"}) {
        CAPTURE(text);
        put(text);
        const auto refused = write_ready_file(path, {}, "off");
        REQUIRE_FALSE(refused);
        CHECK(refused.error().message.find(path.string()) != std::string::npos);
        CHECK(std::filesystem::file_size(path) == std::string(text).size());
    }
    // Neither a folder nor the target of a link is replaced.
    const auto link = folder.path() / "link";
    std::filesystem::create_symlink(path, link);
    CHECK_FALSE(check_ready_file(link));
    CHECK_FALSE(check_ready_file(folder.path()));
    CHECK(files_in(folder.path()) == 2);
}

TEST_CASE("at the end a daemon removes its own ready file and no other") {
    const test::TemporaryFolder folder;
    const auto path = folder.path() / "ready.json";
    REQUIRE(write_ready_file(path, {}, "off"));
    remove_ready_file(path);
    CHECK_FALSE(std::filesystem::exists(path));
    std::ofstream(path) << R"({"listen":[],"http":"off","pid":1})";
    remove_ready_file(path);
    CHECK(std::filesystem::exists(path));
}

TEST_CASE("a ready file that cannot be written is an error that names it") {
    const auto written = write_ready_file("/does/not/exist/ready.json", {}, "off");
    REQUIRE_FALSE(written);
    CHECK(written.error().message.find("/does/not/exist") != std::string::npos);
}

TEST_CASE("a state folder has one owner at a time") {
    const test::TemporaryFolder folder;
    const auto state = folder.path() / "state";
    {
        const auto first = StateLock::take(state);
        REQUIRE(first);
        CHECK((std::filesystem::status(state).permissions() & std::filesystem::perms::others_all) ==
              std::filesystem::perms::none);
        CHECK_FALSE(StateLock::take(state));
    }
    CHECK(StateLock::take(state));
}

TEST_CASE("a state folder that is a file is an error that names a remedy") {
    const test::TemporaryFolder folder;
    const auto file = folder.path() / "file";
    std::ofstream(file) << "x";
    const auto taken = StateLock::take(file);
    REQUIRE_FALSE(taken);
    CHECK(taken.error().message.find(file.string()) != std::string::npos);
    CHECK(taken.error().message.find("name a folder that can be written") != std::string::npos);
}

}  // namespace
}  // namespace raynest::server
