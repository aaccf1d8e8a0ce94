#include "server/ground/address.h"

#include <doctest/doctest.h>

#include <string>

namespace raynest::server {
namespace {

TEST_CASE("the page has an address with a scheme or without") {
    for (const char* plain : {"127.0.0.1:1", "http://127.0.0.1:1"})
        CHECK(to_uri(*parse_http_address(plain)) == "http://127.0.0.1:1");
    const auto encrypted = parse_http_address("https://[::1]:2");
    CHECK(to_uri(*encrypted) == "https://[::1]:2");
    CHECK(scheme_of(*encrypted) == "https");
    for (const char* wrong :
         {"https:/127.0.0.1:1", "https://", "httpss://127.0.0.1:1", "tls://127.0.0.1:1"})
        CHECK_FALSE(parse_http_address(wrong));
}

TEST_CASE("an address that parses is written back as it was") {
    for (const char* uri : {"tcp://127.0.0.1:31060", "tcp://127.9.8.7:0", "tls://[::1]:65535",
                            "unix:/run/raynest/socket", "unix:relative"}) {
        const auto address = parse_address(uri);
        REQUIRE_MESSAGE(address, uri);
        CHECK(to_uri(*address) == uri);
    }
    CHECK(to_uri(*parse_address("tcp://localhost:1")) == "tcp://127.0.0.1:1");
}

TEST_CASE("addresses that other machines may reach are told apart") {
    for (const char* uri :
         {"tcp://0.0.0.0:1", "tls://10.0.0.1:1", "tcp://[::]:1", "tls://[2001:db8::1]:1"})
        CHECK_MESSAGE(is_beyond_loopback(*parse_address(uri)), uri);
    for (const char* uri : {"tcp://127.0.0.1:1", "tls://127.9.8.7:1", "tcp://[::1]:1", "unix:x"})
        CHECK_FALSE_MESSAGE(is_beyond_loopback(*parse_address(uri)), uri);
}

TEST_CASE("a host's name is refused with what is needed in its place") {
    CHECK(parse_address("tcp://example.org:1").error().message.find("an IP address or localhost") !=
          std::string::npos);
}

TEST_CASE("an invalid address is refused") {
    const std::string long_path = "unix:" + std::string(108, 'x');
    for (const std::string& uri :
         {std::string(""), std::string("tcp://"), std::string("tcp://127.0.0.1"),
          std::string("tcp://127.0.0.1:"), std::string("tcp://127.0.0.1:65536"),
          std::string("tcp://127.0.0.1:-1"), std::string("tcp://127.0.0.1:1x"),
          std::string("tcp://host.example:1"), std::string("tcp://:1"), std::string("unix:"),
          std::string("http://127.0.0.1:1"), std::string("unix:a\0b", 8), long_path})
        CHECK_FALSE_MESSAGE(parse_address(uri), uri);
}

}  // namespace
}  // namespace raynest::server
