// Sessions over a transport in memory: what they do does not depend on how bytes are cut, and no
// byte renews a deadline or a place.
#include "server/sessions/session.h"

#include "engine/math/random.h"
#include "protocol/text.h"
#include "server/net/socket_transport.h"
#include "tests/unit/server/memory_transport.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <functional>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;
using test::MemoryDaemon;
using test::MemoryPeer;

using Heard = std::vector<std::pair<std::uint16_t, std::vector<std::byte>>>;  // type and bulk

bool is(const protocol::Frame& frame, wire::Message type) {
    return frame.header.type == static_cast<std::uint16_t>(type);
}

/// The code of the last frame, if that is an error.
std::optional<Code> last_error(MemoryPeer& peer) {
    const auto frames = peer.take_frames();
    if (frames.empty()) return std::nullopt;
    const auto error = protocol::open<wire::Error>(frames.back());
    return error ? std::optional(static_cast<Code>((*error)->code())) : std::nullopt;
}

std::unique_ptr<MemoryPeer> greeted(MemoryDaemon& house, const std::string& name = "memory") {
    auto peer = house.connect(name);
    peer->say(0, wire::HelloT{});
    house.settle();
    const auto frames = peer->take_frames();
    REQUIRE(frames.size() == 1);
    REQUIRE(is(frames[0], wire::Message::Welcome));
    return peer;
}

protocol::Frame rays_frame(std::uint64_t first, std::uint64_t count) {
    protocol::Bulk bulk;
    bulk.add("rays", wire::Dtype::f32, 8, count);
    bulk.allocate();
    const auto floats = bulk.block_as<float>(0);
    for (std::uint64_t ray = 0; ray < count; ++ray) {
        const float x = static_cast<float>(first + ray) * 0.001F;
        const std::array<float, 8> down = {x, 9, 0, 0, 0, -1, 0, 100};
        std::copy(down.begin(), down.end(), floats.begin() + static_cast<std::ptrdiff_t>(8 * ray));
    }
    wire::QueryRaysT message;
    message.first_ray = first;
    return protocol::encode(5, std::move(message), std::move(bulk)).value();
}

/// Hello, a ping, a query with its rays, a request that is refused, and a frame that ends it all.
Heard converse(const std::function<std::size_t(std::size_t)>& piece) {
    MemoryDaemon house;
    const auto peer = house.connect();
    peer->wire->piece = piece;
    peer->say(0, wire::HelloT{});
    peer->say(1, wire::PingT{});
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.fields = {"t", "prim", "path"};
    query.ray_count = 3000;
    peer->say(5, query);
    for (const std::uint64_t first : {0U, 1000U, 2000U}) {
        peer->send_frame(rays_frame(first, 1000));
        house.settle();
    }
    wire::InfoT info;
    info.scene = "nothing";
    peer->say(6, info);
    peer->say(0, wire::HelloT{});
    house.settle();
    CHECK(peer->wire->finished);
    Heard heard;
    for (const protocol::Frame& frame : peer->take_frames()) {
        // Depends on the clock.
        if (is(frame, wire::Message::Progress)) continue;
        const auto bulk = frame.bulk.span();
        heard.emplace_back(frame.header.type, std::vector<std::byte>(bulk.begin(), bulk.end()));
    }
    return heard;
}

TEST_CASE("a conversation is the same however a transport cuts its bytes") {
    const Heard whole = converse([](std::size_t most) { return most; });
    std::vector<wire::Message> types;
    for (const auto& [type, bulk] : whole) types.push_back(static_cast<wire::Message>(type));
    using enum wire::Message;
    CHECK(types == std::vector{Welcome, Pong, Started, Chunk, Chunk, Chunk, Done, Error, Error});
    CHECK(converse([](std::size_t) { return std::size_t{1}; }) == whole);
    Random random(25);
    for (int round = 0; round < 20; ++round) {
        CAPTURE(round);
        CHECK(converse([&](std::size_t most) {
                  return 1 + random.next() %
                                 (random.next() % 2 == 0 ? most : std::min<std::size_t>(most, 40));
              }) == whole);
    }
}

protocol::Limits hasty() {
    protocol::Limits limits;
    limits.give_way_ms = 0;
    limits.greeting_ms_max = 60;
    return limits;
}

/// A whole frame of `peer` comes and another one goes.
void exchange(MemoryDaemon& house, MemoryPeer& peer) {
    peer.say(1, wire::PingT{});
    house.settle();
    REQUIRE(peer.take_frames().size() == 1);
}

/// True if the first of the two gives way to a newcomer, false if the second does.
bool first_gives_way(MemoryDaemon& house, MemoryPeer& first, MemoryPeer& second) {
    REQUIRE(house.daemon.peers.make_room(Resource::connections, "newcomer"));
    house.settle();
    REQUIRE(first.wire->closed != second.wire->closed);
    return first.wire->closed;
}

TEST_CASE("a peer that sends many requests at once lets others have their turns") {
    MemoryDaemon house;
    const auto many = greeted(house, "many");
    const auto one = greeted(house, "one");
    constexpr std::size_t requests = 60;
    for (std::size_t id = 1; id <= requests; ++id) many->say(id, wire::VariantsT{});
    one->say(1, wire::PingT{});
    house.io.restart();
    while (one->wire->to_peer.empty()) REQUIRE(house.io.poll_one() != 0);
    const std::size_t answered = many->take_frames().size();
    CHECK(answered < requests);
    house.settle();
    CHECK(answered + many->take_frames().size() == requests);
}

TEST_CASE("the connections of one principal share its turns") {
    // A message takes the whole turn: the handler of Hello waits, and each connection says one.
    MemoryDaemon house({},
                       [](const PeerIdentity& peer, const wire::Hello&,
                          const protocol::Limits&) -> Reply<Principal> {
                           if (peer.name == "crowd") std::this_thread::sleep_for(turn_time);
                           return Principal{peer.name, {}, Role::user};
                       });
    constexpr std::size_t crowd_size = 60;
    std::vector<std::unique_ptr<MemoryPeer>> crowd;
    for (std::size_t i = 0; i < crowd_size; ++i) crowd.push_back(house.connect("crowd"));
    const auto one = greeted(house, "one");
    for (const auto& peer : crowd) peer->say(0, wire::HelloT{});
    one->say(1, wire::PingT{});
    house.io.restart();
    while (one->wire->to_peer.empty()) REQUIRE(house.io.poll_one() != 0);
    const auto answered = [&] {
        return std::ranges::count_if(crowd,
                                     [](const auto& peer) { return !peer->wire->to_peer.empty(); });
    };
    // It came last of all, and waits for a round or two.
    CHECK(answered() <= 2);
    house.settle();
    CHECK(answered() == crowd_size);
}

TEST_CASE("a peer that sends single bytes gives way before one that sent a whole frame later") {
    MemoryDaemon house(hasty());
    const auto slow = greeted(house);
    const auto other = greeted(house);
    const auto ping = golden::wire_bytes(protocol::encode(1, wire::PingT{}).value());
    SUBCASE("until the frame is whole") {
        for (std::size_t sent = 0; sent + 1 < ping.size(); ++sent) {
            slow->send(std::span(ping).subspan(sent, 1));
            house.settle();
            if (sent == ping.size() / 2) exchange(house, *other);
        }
        CHECK(first_gives_way(house, *slow, *other));
        CHECK(last_error(*slow) == Code::slow_consumer);
        CHECK(house.daemon.metrics.gave_way_connections == 1);
    }
    SUBCASE("which counts") {
        exchange(house, *other);
        for (const std::byte& byte : ping) {
            slow->send(std::span(&byte, 1));
            house.settle();
        }
        CHECK_FALSE(first_gives_way(house, *slow, *other));
    }
}

TEST_CASE("a peer that reads single bytes gives way before one that read a whole frame later") {
    MemoryDaemon house(hasty());
    const auto slow = greeted(house);
    const auto other = greeted(house);
    slow->make_room(1);
    slow->say(1, wire::StatsT{});
    house.settle();
    const auto read_byte = [&] {
        slow->make_room(1);
        house.settle();
    };
    for (int byte = 0; byte < 20; ++byte) read_byte();
    SUBCASE("until the frame is whole") {
        exchange(house, *other);
        for (int byte = 0; byte < 20; ++byte) read_byte();
        CHECK(slow->wire->to_peer.size() == 41);
        CHECK(first_gives_way(house, *slow, *other));
        // No error fits into the middle of a frame.
        CHECK(slow->take_frames().empty());
    }
    SUBCASE("which counts") {
        exchange(house, *other);
        std::size_t before = 0;
        while (std::exchange(before, slow->wire->to_peer.size()) != slow->wire->to_peer.size())
            read_byte();
        CHECK(slow->take_frames().size() == 1);
        CHECK_FALSE(first_gives_way(house, *slow, *other));
    }
}

TEST_CASE("single bytes do not lengthen the time for a greeting") {
    MemoryDaemon house(hasty());
    const auto hello = golden::wire_bytes(protocol::encode(0, wire::HelloT{}).value());
    const auto slow = house.connect();
    std::size_t sent = 0;
    while (sent < hello.size() && !slow->wire->finished) {
        slow->send(std::span(hello).subspan(sent++, 1));
        house.settle_for(milliseconds(4));
    }
    CHECK(sent < hello.size());
    CHECK(last_error(*slow) == Code::deadline);
    CHECK(house.daemon.metrics.timeouts == 1);
}

TEST_CASE("the time for a greeting includes the transport's own handshake") {
    MemoryDaemon house(hasty());
    const auto silent = house.connect("memory", false);
    silent->say(0, wire::HelloT{});
    house.settle();
    CHECK(silent->wire->to_peer.empty());
    REQUIRE(test::eventually([&] {
        house.settle_for(milliseconds(4));
        return silent->wire->closed;
    }));
    CHECK(silent->wire->to_peer.empty());
    CHECK(house.daemon.metrics.timeouts == 1);
}

/// A token makes the principal; its quota is one connection.
Reply<Principal> by_token(const PeerIdentity& peer, const wire::Hello& hello,
                          const protocol::Limits& limits) {
    const auto token = protocol::text(hello.token());
    if (token.empty()) return authenticate(peer, hello, limits);
    if (token == "wrong") return refuse(Code::not_allowed, "no such token");
    return Principal{"token:" + std::string(token), {.connections = 1}};
}

TEST_CASE("who a peer is, and what it may have, is decided by its greeting") {
    MemoryDaemon house({}, by_token);
    const auto say_hello = [&](const char* token) {
        auto peer = house.connect();
        wire::HelloT hello;
        hello.token = token;
        peer->say(0, hello);
        house.settle();
        return peer;
    };
    const Peers& peers = house.daemon.peers;
    const auto silent = house.connect();
    CHECK(peers.size_of("memory") == 1);
    const auto known = say_hello("a");
    CHECK(is(known->take_frames().at(0), wire::Message::Welcome));
    CHECK(peers.size_of("memory") == 1);
    CHECK(peers.size_of("token:a") == 1);
    // Jobs are the principal's.
    wire::QueryT query;
    query.job = std::make_unique<wire::JobT>();
    query.job->scene = "forest";
    query.ray_count = 1;
    known->say(5, query);
    house.settle();
    CHECK(house.daemon.admission.jobs().begin()->second.principal == "token:a");

    const auto second = say_hello("a");
    CHECK(last_error(*second) == Code::busy);
    CHECK(house.daemon.metrics.connections_refused == 1);
    const auto wrong = say_hello("wrong");
    CHECK(last_error(*wrong) == Code::not_allowed);
    const auto other = say_hello("");
    CHECK(is(other->take_frames().at(0), wire::Message::Welcome));
    CHECK(peers.size_of("token:a") == 1);
}

TEST_CASE("who is admitted no more is closed, and who has said no Hello meets the rule by it") {
    MemoryDaemon house({}, by_token);
    const auto silent = house.connect();
    const auto known = greeted(house);
    house.connections.close_unless(
        [](const PeerIdentity&, const Principal* principal) { return principal == nullptr; },
        {Code::not_allowed, "revoked", 0}, "revoked");
    house.settle();
    CHECK(last_error(*known) == Code::not_allowed);
    CHECK(silent->wire->to_peer.empty());
    CHECK(house.daemon.metrics.revoked == 1);
    silent->say(0, wire::HelloT{});
    house.settle();
    CHECK(is(silent->take_frames().at(0), wire::Message::Welcome));
}

TEST_CASE("asking many peers whether they are admitted lets others have their turns") {
    MemoryDaemon house;
    std::vector<std::unique_ptr<MemoryPeer>> peers;
    for (int i = 0; i < 12; ++i) peers.push_back(greeted(house));
    std::size_t asked = 0;
    bool first = true;
    house.connections.close_unless(
        [&](const PeerIdentity&, const Principal*) {
            // As slow as the verification of a certificate; memory ends once.
            std::this_thread::sleep_for(turn_time);
            ++asked;
            if (std::exchange(first, false)) throw std::bad_alloc();
            return asked % 2 == 0;
        },
        {Code::not_allowed, "revoked", 0}, "revoked");
    std::size_t asked_at_turn = 0;
    asio::post(house.io, [&] { asked_at_turn = asked; });
    house.settle();
    CHECK(asked == peers.size());
    CHECK(asked_at_turn < peers.size() / 2);
    CHECK(house.daemon.metrics.revoked == peers.size() / 2 - 1);
    // The others read their errors first; this one could not be asked.
    CHECK(house.connections.size() == peers.size() - 1);
}

TEST_CASE("many changes at a time ask each peer a second time at most") {
    MemoryDaemon house;
    std::vector<std::unique_ptr<MemoryPeer>> peers;
    for (int i = 0; i < 4; ++i) peers.push_back(greeted(house));
    std::size_t asked = 0;
    const auto change = [&] {
        house.connections.close_unless(
            [&](const PeerIdentity&, const Principal*) {
                std::this_thread::sleep_for(turn_time);
                ++asked;
                return true;
            },
            {Code::not_allowed, "revoked", 0}, "revoked");
    };
    for (int i = 0; i < 20; ++i) change();
    house.settle();
    CHECK(asked == 2 * peers.size());
    change();
    house.settle();
    CHECK(asked == 3 * peers.size());
}

TEST_CASE("the end of a crowd of connections lets others have their turns") {
    const protocol::Error why{Code::not_allowed, "away with you", 0};
    using End = std::function<void(Connections&)>;
    for (const End& end :
         {End([&](auto& all) { CHECK(all.kick(0, "memory", why) == 800); }), End([](auto& all) {
              for (int i = 0; i < 3; ++i) all.drain();
          }),
          End([&](auto& all) { all.close_with_error(why); })}) {
        MemoryDaemon house;
        std::vector<std::unique_ptr<MemoryPeer>> peers;
        for (int i = 0; i < 800; ++i) peers.push_back(greeted(house));
        end(house.connections);
        CHECK(house.daemon.metrics.kicked < 800);
        house.settle();
        CHECK(std::ranges::all_of(peers, [](const auto& peer) { return peer->wire->finished; }));
    }
}

TEST_CASE("all addresses of an IPv6 network are one peer, and the log still tells them apart") {
    const auto peer = [](const char* address) {
        return identity_of(asio::ip::make_address(address));
    };
    for (const char* address : {"2001:db8:1:2::1", "2001:db8:1:2:ffff:ffff:ffff:ffff"}) {
        CHECK(peer(address).name == "2001:db8:1:2::/64");
        CHECK(peer(address).whereabouts() == address);
        CHECK(peer(address).place == PeerIdentity::Place::remote);
    }
    CHECK(peer("2001:db8:1:3::1").name == "2001:db8:1:3::/64");
    CHECK(peer("192.0.2.7").name == "192.0.2.7");
    CHECK(peer("::ffff:192.0.2.7").name == "192.0.2.7");
    CHECK(peer("192.0.2.7").whereabouts() == "192.0.2.7");
    for (const char* loopback : {"::1", "127.8.9.1", "::ffff:127.0.0.1"}) {
        CHECK(peer(loopback).name == "127.0.0.1");
        CHECK(peer(loopback).place == PeerIdentity::Place::loopback);
    }
}

TEST_CASE("peers that have sent no Hello take no connection from the principal of their address") {
    protocol::Limits limits;
    limits.principal_connections_max = 1;
    MemoryDaemon house(limits);
    const auto silent = house.connect();
    const auto first = greeted(house);
    const auto second = house.connect();
    second->say(0, wire::HelloT{});
    house.settle();
    CHECK(last_error(*second) == Code::busy);
    CHECK_FALSE(silent->wire->finished);
}

TEST_CASE("a daemon full of peers without a Hello ends the oldest of the address with most") {
    protocol::Limits limits;
    limits.connections_max = 4;
    MemoryDaemon house(limits);
    const auto single = house.connect("single");
    std::vector<std::unique_ptr<MemoryPeer>> crowd;
    for (int i = 0; i < 3; ++i) crowd.push_back(house.connect("crowd"));
    const auto client = greeted(house, "client");
    CHECK(crowd[0]->wire->closed);
    CHECK_FALSE(crowd[1]->wire->closed);
    CHECK_FALSE(single->wire->closed);
    CHECK(house.daemon.metrics.greetings_gave_way == 1);
}

TEST_CASE("what a peer does before its Hello is counted for the daemon alone") {
    MemoryDaemon house;
    const auto client = greeted(house, "client");
    const Metrics& metrics = house.daemon.metrics;
    constexpr std::size_t received = position_of(&Metrics::bytes_received);
    CHECK(metrics.bytes_received > 0);
    CHECK(metrics.own.of("client", received) == 0);
    client->say(1, wire::PingT{});
    house.settle();
    CHECK(metrics.own.of("client", received) > 0);
}

}  // namespace
}  // namespace raynest::server
