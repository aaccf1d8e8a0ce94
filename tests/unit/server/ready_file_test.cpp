#include "server/ready_file.h"

#include "tests/temporary_folder.h"

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <fstream>
#include <vector>

namespace raynest::server {
namespace {

TEST_CASE("the ready file holds addresses and pid, and no half-written one is left") {
    const test::TemporaryFolder folder;
    const auto path = folder.path() / "ready.json";
    const std::vector<std::string> listen = {"tcp://127.0.0.1:1", "unix:/a b"};
    REQUIRE(write_ready_file(path, listen));
    std::ifstream file(path);
    const auto content = nlohmann::json::parse(file);
    CHECK(content["listen"] == nlohmann::json(listen));
    CHECK(content["http"] == "off");
    CHECK(content["pid"] == getpid());
    CHECK_FALSE(std::filesystem::exists(path.string() + ".tmp"));
}

TEST_CASE("a ready file that cannot be written is an error that names it") {
    const auto written = write_ready_file("/does/not/exist/ready.json", {});
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

TEST_CASE("a state folder that is a file is an error that says what to give") {
    const test::TemporaryFolder folder;
    const auto file = folder.path() / "file";
    std::ofstream(file) << "x";
    const auto taken = StateLock::take(file);
    REQUIRE_FALSE(taken);
    CHECK(taken.error().message.find(file.string()) != std::string::npos);
    CHECK(taken.error().message.find("give --state a folder") != std::string::npos);
}

}  // namespace
}  // namespace raynest::server
