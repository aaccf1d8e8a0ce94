#include "client/commands/parse.h"

#include <doctest/doctest.h>

#include <iterator>
#include <sstream>
#include <string>
#include <vector>

using namespace raynest::client;

namespace {

bool may_repeat(const std::string& line, const Failure& why = lost(Exit::failed, "gone"),
                bool printed = false) {
    std::istringstream stream("raynest " + line);
    const std::vector<std::string> words{std::istream_iterator<std::string>(stream), {}};
    std::vector<const char*> argv;
    for (const std::string& word : words) argv.push_back(word.c_str());
    const auto parsed = parse_options(static_cast<int>(argv.size()), argv.data());
    REQUIRE_MESSAGE(parsed, line);
    REQUIRE(parsed->options);
    return may_repeat(*parsed->options->command, parsed->options->acts, why, printed);
}

}  // namespace

TEST_CASE("a command whose request acts runs once") {
    for (const char* line : {"gc", "admin drain", "cancel 17", "edit forest --hide oak",
                             "unload forest", "restore scenes.tar", "open"})
        CHECK_MESSAGE(!may_repeat(line), line);
}

TEST_CASE("so does one that acts without a request") {
    CHECK(!may_repeat("login tls://a:1"));
    CHECK(!may_repeat("logout tls://a:1"));
}

TEST_CASE(
    "a command that asks runs again where its daemon is lost, and "
    "nowhere else") {
    CHECK(may_repeat("scenes"));
    CHECK(may_repeat("stats"));
    CHECK(may_repeat("info forest"));
    CHECK(!may_repeat("info forest", failure(Exit::busy, "full")));
    CHECK(!may_repeat("info forest", lost(Exit::failed, "gone"), true));
    CHECK(may_repeat("top", lost(Exit::failed, "gone"), true));
}

TEST_CASE("what came through a pipe is not read again") {
    CHECK(may_repeat("load builtin:forest"));
    CHECK(!may_repeat("load - --name forest"));
    CHECK(may_repeat("query forest --ray 0,1,5,0,0,-1"));
    CHECK(!may_repeat("query forest --rays -"));
    CHECK(may_repeat("render forest -o a.png"));
    CHECK(!may_repeat("render /dev/null -o a.png"));
    CHECK(!may_repeat("backup -"));
}
