#include "server/options.h"

#include <doctest/doctest.h>

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
                                                      {"stray"}}) {
        const auto parsed = parse(arguments);
        CHECK_FALSE(parsed.options);
        CHECK(parsed.exit_code == 2);
    }
}

}  // namespace
}  // namespace raynest::server
