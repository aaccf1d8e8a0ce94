#include "client/net/address.h"

#include <doctest/doctest.h>

using namespace raynest::client;

TEST_CASE("only addresses of the loopback are the loopback's") {
    for (const char* host : {"127.0.0.1", "127.255.1.2", "::1", "0:0::1", "::ffff:127.0.0.1"})
        CHECK_MESSAGE(is_loopback(host), host);
    for (const char* host :
         {"", "localhost", "127", "127.1", "127.0.0.1.", "127.evil.invalid", "128.0.0.1", "0.0.0.0",
          "::", "::2", "::ffff:128.0.0.1", "::127.0.0.1", "[::1]"})
        CHECK_MESSAGE(!is_loopback(host), host);
}

TEST_CASE("this machine is a Unix socket, the loopback, or localhost") {
    for (const char* uri : {"unix:/x", "tcp://127.0.0.1:1", "tcp://LocalHost:1", "tls://[::1]:1"})
        CHECK_MESSAGE(is_this_machine(uri), uri);
    for (const char* uri :
         {"tcp://127.evil.invalid:1", "tcp://localhost.evil:1", "tcp://127.0.0.1@evil:1",
          "ssh://localhost", "tcp://localhost", "http://127.0.0.1:1"})
        CHECK_MESSAGE(!is_this_machine(uri), uri);
}

TEST_CASE("an address is split into a host and a port, or it is none") {
    CHECK(authority_of("tls://gpu.example.org:31062")->host == "gpu.example.org");
    CHECK(authority_of("tls://gpu.example.org:31062")->port == "31062");
    CHECK(authority_of("tcp://[fe80::1%eth0]:5")->host == "fe80::1%eth0");
    for (const char* uri :
         {"tcp://", "tcp://host", "tcp://:1", "tcp://host:0", "tcp://host:65536", "tcp://a/b:1",
          "tcp://a b:1", "tcp://me@host:1", "tcp://::1:1", "tcp://[]:1", "tcp://h\x1b:1"})
        CHECK_MESSAGE(!authority_of(uri), uri);
}

TEST_CASE("names are compared without case, users and paths with theirs") {
    CHECK(comparable("TLS://GPU.Example.org:5") == "tls://gpu.example.org:5");
    CHECK(comparable("ssh://Me@GPU:22/Run/Socket") == "ssh://Me@gpu:22/Run/Socket");
    CHECK(comparable("UNIX:/Run/Socket") == "unix:/Run/Socket");
    CHECK(comparable("") == "");
}
