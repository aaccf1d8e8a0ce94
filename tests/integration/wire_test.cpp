// Sends bytes of every kind to a real daemon: it stays alive, reports the error, and serves others.
#include "tests/golden/examples.h"
#include "tests/golden/malformed.h"
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <string_view>
#include <thread>

namespace raynest::test {
namespace {

using protocol::Code;
using Clock = std::chrono::steady_clock;

/// True if the name of a frame begins with that of a request which needs the role admin.
bool is_for_admins(std::string_view name) {
    enum class Needed { viewer, user, admin };
    constexpr Needed viewer = Needed::viewer, user = Needed::user, admin = Needed::admin;
    bool is = false;
#define RAYNEST_REQUEST(number, Name, handler, needs, role, ...) \
    is = is || (role == admin && name.starts_with(#Name " "));
#include "protocol/lists/requests.def"
    static_cast<void>(viewer), static_cast<void>(user);
    return is;
}

TEST_CASE_FIXTURE(Served, "every malformed frame gets its error, and the daemon serves on") {
    const auto table = golden::malformed_frames();
    REQUIRE(table.size() >= 200);
    for (const golden::Malformed& row : table) {
        INFO(row.name);
        Peer guest(daemon);
        guest.greet();
        if (row.needs_query) {
            REQUIRE(guest.say(golden::query_id, query_of(2)));
            guest.read_until<wire::Started>();
        }
        guest.send(row.bytes);
        const auto code = guest.read_error();
        REQUIRE(code.has_value());
        // The role is checked before the content: only an administrator hears what is wrong.
        const Code expected = is_for_admins(row.name) ? Code::not_allowed : row.code;
        CHECK(protocol::error_info(*code).name == protocol::error_info(expected).name);
        CHECK((row.closes ? guest.ends() : guest.answers()));
    }
    CHECK(peer.answers());
    CHECK(counter(peer, "jobs_started") == counter(peer, "jobs_ended"));
    tally("malformed frames, lengths up to 2^64", table.size(), "each got its error");
}

TEST_CASE_FIXTURE(Served, "every message cut at every byte leaves nothing behind") {
    const std::size_t descriptors = daemon.descriptors();

    std::size_t cuts = 0;
    for (const golden::Example& example : golden::examples()) {
        const std::vector<std::byte> bytes = golden::wire_bytes(example.frame);
        for (std::size_t size = 0; size < bytes.size(); ++size) {
            Peer guest(daemon);
            REQUIRE(guest.say(0, wire::HelloT{}));
            guest.send(std::span(bytes).first(size));
            ++cuts;
        }
    }
    CHECK(eventually([&] {
        return counter(peer, "connections_accepted") == counter(peer, "connections_closed") + 1;
    }));
    CHECK(eventually([&] { return daemon.descriptors() == descriptors; }));
    CHECK(counter(peer, "jobs_started") == counter(peer, "jobs_ended"));
    tally("messages cut at every byte", cuts, "jobs and descriptors are back");
}

TEST_CASE_FIXTURE(Served, "a query in one-byte writes gets the same answer as in one piece") {
    const auto ask = [&](bool bytewise) {
        const protocol::Frame query = protocol::encode(9, query_of(3)).value();
        const protocol::Frame rays = rays_frame(9, 0, 3);
        for (const protocol::Frame* frame : {&query, &rays}) {
            const std::vector<std::byte> bytes = golden::wire_bytes(*frame);
            for (std::size_t i = 0; bytewise && i < bytes.size(); ++i)
                REQUIRE(peer.send(std::span(bytes).subspan(i, 1)));
            if (!bytewise) REQUIRE(peer.send(bytes));
        }
        std::vector<std::byte> answer = golden::wire_bytes(peer.read_until<wire::Chunk>());
        peer.read_until<wire::Done>();
        return answer;
    };
    CHECK(ask(true) == ask(false));
    tally("queries in one-byte writes", 1, "the same answer");
}

TEST_CASE("a client of another protocol version is told which versions there are") {
    const Daemon daemon;
    Peer peer(daemon);
    wire::HelloT hello;
    hello.version_min = 2;
    hello.version_max = 9;
    REQUIRE(peer.say(0, hello));
    CHECK(peer.read_error() == Code::unsupported_version);
    CHECK(peer.ends());
    tally("clients of another version", 1, "told which there are, and closed");
}

TEST_CASE("a browser that finds the port gets an error") {
    const Daemon daemon;
    Peer peer(daemon);
    peer.send(std::string_view("GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"));
    CHECK(peer.read_error() == Code::bad_frame);
    CHECK(peer.ends());
    tally("HTTP requests", 1, "got an error, and closed");
}

TEST_CASE("a request before the greeting ends the connection") {
    const Daemon daemon;
    Peer peer(daemon);
    REQUIRE(peer.say(1, wire::ScenesT{}));
    CHECK(peer.read_error() == Code::bad_frame);
    CHECK(peer.ends());
}

TEST_CASE("silence before the greeting ends in time, also when it is broken byte by byte") {
    const Daemon daemon;
    Peer silent(daemon);
    Peer dripping(daemon);
    const std::vector<std::byte> hello =
        golden::wire_bytes(protocol::encode(0, wire::HelloT{}).value());
    const auto begin = Clock::now();
    const std::chrono::milliseconds most(protocol::Limits{}.greeting_ms_max);
    for (std::size_t i = 0; i + 1 < hello.size() && Clock::now() < begin + most; ++i) {
        if (!dripping.send(std::span(hello).subspan(i, 1))) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    for (Peer* peer : {&silent, &dripping}) {
        CHECK(peer->read_error() == Code::deadline);
        CHECK(peer->ends());
    }
    CHECK(Clock::now() >= begin + most);
    tally("silence before Hello, and single bytes of it", 2, "closed with DEADLINE");
}

TEST_CASE_FIXTURE(Served, "an announced bulk part costs no memory until it comes") {
    const std::uint64_t before = daemon.resident_bytes();
    std::vector<std::unique_ptr<Peer>> peers;
    constexpr std::size_t count = 100;
    for (std::size_t i = 0; i < count; ++i) {
        peers.push_back(std::make_unique<Peer>(daemon));
        peers.back()->greet();
        // The control part is empty, so the decoder goes on to the bulk part.
        protocol::FrameHeader header;
        header.type = static_cast<std::uint16_t>(wire::Message::Upload);
        header.block_count = 1;
        header.bulk_bytes = 8 << 20;
        header.request_id = 5;
        std::array<std::byte, protocol::header_bytes> bytes{};
        protocol::write_header(header, bytes);
        REQUIRE(peers.back()->send(bytes));
    }
    REQUIRE(peer.answers());
    if (!sanitized) CHECK(daemon.resident_bytes() < before + count * (64 << 10));
    tally("announced bodies of 8 MiB that never come", count, "under 64 KiB each");
}

}  // namespace
}  // namespace raynest::test
