#include "server/options.h"

#include <doctest/doctest.h>

#include <iostream>
#include <sstream>
#include <string>
#include <vector>

namespace raynest::server {
namespace {

ParsedOptions parse(const std::vector<const char*>& arguments) {
    std::vector<const char*> argv = {"raynestd"};
    for (const char* argument : arguments) argv.push_back(argument);
    return parse_options(static_cast<int>(argv.size()), argv.data());
}

TEST_CASE("without arguments the defaults fit this machine") {
    const auto parsed = parse({});
    REQUIRE(parsed.options);
    CHECK(parsed.options->listen == std::vector<std::string>{"tcp://127.0.0.1:31060"});
    CHECK(parsed.options->threads >= 1);
    CHECK(parsed.options->memory > (1ULL << 28));
    CHECK(parsed.options->log_level == LogLevel::info);
}

TEST_CASE("options are taken as given") {
    const auto parsed =
        parse({"--listen", "unix:/tmp/a", "--listen", "tcp://[::1]:0", "--threads", "3", "--memory",
               "2G", "--log-level", "debug", "--http", "off", "--state", "/tmp/s"});
    REQUIRE(parsed.options);
    CHECK(parsed.options->listen == std::vector<std::string>{"unix:/tmp/a", "tcp://[::1]:0"});
    CHECK(parsed.options->threads == 3);
    CHECK(parsed.options->memory == 2ULL << 30);
    CHECK(parsed.options->log_level == LogLevel::debug);
    CHECK(parsed.options->state == "/tmp/s");
}

TEST_CASE("a usage error is exit code 2") {
    for (const std::vector<const char*>& arguments : {std::vector<const char*>{"--threads", "0"},
                                                      {"--threads", "many"},
                                                      {"--memory", "1"},
                                                      {"--memory", "-1"},
                                                      {"--target", "v5"},
                                                      {"--listen", "tcp://0.0.0.0:1"},
                                                      {"--http", "127.0.0.1:1"},
                                                      {"--scene-root", "/does/not/exist"},
                                                      {"--log-level", "loud"},
                                                      {"--config", "/does/not/exist"},
                                                      {"--unknown"},
                                                      {"--principal_jobs_max", "5"},
                                                      {"--socket-mode", "0060"},
                                                      {"--socket-mode", "0780"},
                                                      {"--socket-mode", "rw"},
                                                      {"--socket-group", "no-such-group"},
                                                      {"stray"}}) {
        const auto parsed = parse(arguments);
        CHECK_FALSE(parsed.options);
        CHECK(parsed.exit_code == 2);
    }
}

/// What is written to stderr while an argument list is refused.
std::string complaint(const std::vector<const char*>& arguments) {
    std::ostringstream text;
    std::streambuf* const before = std::cerr.rdbuf(text.rdbuf());
    const auto parsed = parse(arguments);
    std::cerr.rdbuf(before);
    CHECK(parsed.exit_code == 2);
    return text.str();
}

bool mentions(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

TEST_CASE("limits are spelled with hyphens, and the old spelling names the new one") {
    CHECK(parse({"--principal-jobs-max", "5"}).options->limits.principal_jobs_max == 5);
    for (const auto& arguments : {std::vector<const char*>{"--principal_jobs_max", "5"},
                                  {"--principal_jobs_max=5"},
                                  {"--log_level", "debug"}})
        CHECK(mentions(complaint(arguments), "is now spelled --"));
    CHECK(mentions(complaint({"--principal_jobs_max=5"}), "--principal-jobs-max"));
}

TEST_CASE("a socket is opened to a group by its name or number") {
    CHECK(parse({}).options->socket.mode == 0600);
    CHECK_FALSE(parse({}).options->socket.group);
    const auto root = parse({"--socket-group", "root"});
    CHECK(root.options->socket.group == 0);
    CHECK(root.options->socket.mode == 0660);
    const auto both = parse({"--socket-group", "17", "--socket-mode", "0600"});
    CHECK(both.options->socket.group == 17);
    CHECK(both.options->socket.mode == 0600);
    CHECK(mentions(complaint({"--socket-mode", "0860"}), "'0860' is not a mode"));
    CHECK(mentions(complaint({"--socket-group", "nobody-there"}), "no group 'nobody-there'"));
}

}  // namespace
}  // namespace raynest::server
