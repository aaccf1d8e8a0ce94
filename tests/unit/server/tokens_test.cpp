#include "server/security/tokens.h"

#include "server/security/secret_file.h"
#include "tests/temporary_folder.h"
#include "tests/unit/server/file_place.h"

#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <string>

namespace raynest::server {
namespace {

using namespace std::chrono_literals;

TEST_CASE("a token has 256 random bits, and its hash is SHA-256") {
    const std::string token = new_token();
    CHECK(token.size() == 4 + 64);
    CHECK(token.starts_with("rnt_"));
    CHECK(token != new_token());
    TokenTable table;
    table.put({TokenRow::Kind::token, "a", Role::user, hash_token("abc"), {}, {}});
    CHECK(
        table.to_text().find("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad") !=
        std::string::npos);
}

TEST_CASE("a table is read as it was written") {
    TokenTable table;
    table.put({TokenRow::Kind::token,
               "alice",
               Role::user,
               hash_token("x"),
               WallClock::time_point(1700000000s),
               {.jobs = 8, .scene_bytes = 1ULL << 33}});
    table.put({TokenRow::Kind::certificate, "CN=a robot,O=Lab 7", Role::admin, {}, {}, {}});
    const auto read = TokenTable::parse("# comment\n\n" + table.to_text());
    REQUIRE(read);
    CHECK(read->rows() == table.rows());
}

TEST_CASE("rows are found by name and by token, and what is erased or expired is not") {
    TokenTable table;
    const auto time = [](int seconds) {
        return WallClock::time_point(std::chrono::seconds(seconds));
    };
    using Kind = TokenRow::Kind;
    table.put({Kind::token, "a", Role::user, hash_token("x"), time(20), {}});
    table.put({Kind::token, "b", Role::user, hash_token("x"), time(10), {}});
    table.put({Kind::token, "c", Role::user, hash_token("y"), {}, {}});
    table.put({Kind::certificate, "CN=z", Role::user, {}, {}, {}});
    CHECK(table.find_token("x", time(0))->name == "b");
    CHECK(table.find_token("x", time(10))->name == "a");
    CHECK(table.find_token("x", time(20)) == nullptr);
    CHECK(table.next_expiry(time(0)) == time(10));
    CHECK(table.next_expiry(time(10)) == time(20));
    CHECK(table.next_expiry(time(20)) == WallClock::time_point::max());
    CHECK(table.erase("b"));
    CHECK_FALSE(table.erase("b"));
    table.put({Kind::token, "c", Role::viewer, hash_token("w"), {}, {}});
    CHECK(table.find_token("x", time(0))->name == "a");
    CHECK(table.find_token("y", time(0)) == nullptr);
    CHECK(table.find_token("w", time(0)) == table.find_name("c"));
    CHECK(table.find_name("CN=z")->kind == Kind::certificate);
    CHECK(table.find_name("b") == nullptr);
    CHECK(table.next_expiry(time(0)) == time(20));
    CHECK(table.rows().size() == 3);
}

TEST_CASE("an invalid row is named by its line") {
    const std::string hash(64, 'a');
    for (const auto& [row, why] :
         {std::pair<std::string, const char*>{"token user never - " + hash, "six fields"},
          {"tokens user never - " + hash + " a", "neither token nor cert"},
          {"token root never - " + hash + " a", "not a role"},
          {"token user soon - " + hash + " a", "neither a Unix time"},
          {"token user 99999999999 - " + hash + " a", "neither a Unix time"},
          {"token user never jobs=0 " + hash + " a", "not a quota"},
          {"token user never - " + hash.substr(1) + " a", "64 hex digits"},
          {"token user never - " + hash + " 127.0.0.1", "not a name"},
          {"token user never - " + hash + " a\x1b", "printable"}}) {
        const auto read = TokenTable::parse("# one\n" + row + "\n");
        REQUIRE_FALSE_MESSAGE(read, row);
        CHECK(read.error().message.starts_with("line 2: "));
        CHECK_MESSAGE(read.error().message.find(why) != std::string::npos, read.error().message);
    }
    const std::string twice = "token user never - " + hash + " a\n";
    CHECK(TokenTable::parse(twice + twice).error().message.starts_with("line 2: "));
}

TEST_CASE("a file that others can read is refused") {
    const test::TemporaryFolder folder;
    const std::filesystem::path file = folder.path() / "tokens";
    REQUIRE(TokenTable().write(place_of(file)));
    CHECK(TokenTable::read(file, Reader::daemon));
    for (const mode_t mode : {0644U, 0604U, 0620U, 0660U}) {
        REQUIRE(chmod(file.c_str(), mode) == 0);
        const auto read = TokenTable::read(file, Reader::command);
        REQUIRE_FALSE(read);
        CHECK(read.error().message.find("chmod 600") != std::string::npos);
    }
    CHECK_FALSE(TokenTable::read(folder.path() / "none", Reader::command));
    CHECK(TokenTable::read_to_edit(*FilePlace::find(folder.path() / "none"))->rows().empty());
}

TEST_CASE("rows that could not be read again are not written") {
    const test::TemporaryFolder folder;
    const std::filesystem::path file = folder.path() / "tokens";
    TokenTable good;
    good.put({TokenRow::Kind::token, "alice", Role::user, hash_token("x"), {}, {}});
    REQUIRE(good.write(place_of(file)));
    for (const char* name : {"", "CN=a\nb", "CN=\x1b", " "}) {
        TokenTable bad = good;
        bad.put({TokenRow::Kind::certificate, name, Role::user, {}, {}, {}});
        const auto written = bad.write(place_of(file));
        REQUIRE_FALSE_MESSAGE(written, name);
        CHECK(written.error().message.find("would become unusable") != std::string::npos);
    }
    CHECK(TokenTable::read(file, Reader::daemon)->rows() == good.rows());
    TokenTable large = good;
    const std::string subject = "CN=" + std::string(1000, 'a');
    for (int i = 0; i < 5000; ++i)
        large.put(
            {TokenRow::Kind::certificate, subject + std::to_string(i), Role::user, {}, {}, {}});
    CHECK(large.write(place_of(file)).error().code == ErrorCode::limit_exceeded);
    CHECK(TokenTable::read(file, Reader::daemon)->rows() == good.rows());
}

TEST_CASE("quotas are read and written") {
    CHECK(parse_quota("")->jobs == 0);
    CHECK(to_text(*parse_quota("rays=1,jobs=2")) == "jobs=2,rays=1");
    CHECK(parse_quota("scene_bytes=20G")->scene_bytes == 20ULL << 30);
    CHECK(to_text(*parse_quota("second_bytes=1.5M")) == "second_bytes=1572864");
    for (const char* wrong : {"scene_bytes=20X", "scene_bytes=G", "jobs=1K", "rays=1M", "jobs",
                              "jobs=", "jobs=-1", "jobs=1.5", "job=1", "jobs=1;rays=2"})
        CHECK_FALSE_MESSAGE(parse_quota(wrong), wrong);
}

}  // namespace
}  // namespace raynest::server
