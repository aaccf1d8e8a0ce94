// Tests clients that pause: they lose nothing while nobody needs their place, and give way when
// somebody does.
#include "tests/golden/examples.h"
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>
#include <signal.h>

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::test {
namespace {

using protocol::Code;

constexpr std::uint64_t chunk = 16384;
using Crowd = std::vector<std::unique_ptr<Peer>>;
using Bytes = std::vector<std::byte>;

/// A daemon that treats a peer as paused almost at once.
struct Hasty : Served {
    explicit Hasty(std::vector<std::string> arguments = {})
        : Served([&] {
              arguments.insert(arguments.end(), {"--give-way-ms", "50"});
              return arguments;
          }()) {}
};

Peer& join(Crowd& crowd, const Daemon& daemon) {
    crowd.push_back(std::make_unique<Peer>(daemon));
    crowd.back()->greet();
    return *crowd.back();
}

/// Returns a query with answers of some 8 MB, for which the daemon makes the rays.
wire::QueryT large_query() {
    wire::QueryT query = query_of(0);
    query.fields = {"t", "prim", "geom", "path", "uv", "position", "ng"};
    query.generator = std::make_unique<wire::GeneratorT>();
    query.generator->kind = "equirectangular";
    query.generator->settings = {"size=380x380"};
    return query;
}

/// Reads the answer to request 5, by first ray, and grants credit for all of it.
std::map<std::uint64_t, Bytes> read_answer(Peer& peer) {
    std::map<std::uint64_t, Bytes> answer;
    for (auto frame = peer.read(); frame; frame = peer.read()) {
        if (frame->header.type == static_cast<std::uint16_t>(wire::Message::Done)) return answer;
        const auto message = protocol::open<wire::Chunk>(*frame);
        if (!message) continue;
        const auto bytes = frame->bulk.span();
        answer[(*message)->first_ray()] = Bytes(bytes.begin(), bytes.end());
        wire::CreditT credit;
        credit.bytes = bytes.size();
        REQUIRE(peer.say(5, credit));
    }
    FAIL("the answer has no end");
    return answer;
}

/// Waits until the daemon sends no more to clients that do not read.
void wait_for_pause(Peer& peer) {
    double before = -1;
    CHECK(eventually([&] {
        const double rays = counter(peer, "rays");
        return std::exchange(before, rays) == rays && rays > 0;
    }));
}

TEST_CASE_FIXTURE(Hasty, "a reader that pauses gets the answer of one that does not") {
    Peer other(daemon);
    other.greet();
    REQUIRE(other.say(5, large_query()));
    const auto expected = read_answer(other);
    CHECK(expected.size() > 4);
    const double jobs = counter(peer, "jobs_ended");

    Peer paused(daemon);
    paused.greet();
    REQUIRE(paused.say(5, large_query()));
    wait_for_pause(peer);
    // Other clients come and go meanwhile without delay.
    REQUIRE(eventually([&] {
        Peer newcomer(daemon);
        newcomer.greet();
        REQUIRE(newcomer.say(5, query_of(1)));
        REQUIRE(newcomer.send_frame(rays_frame(5, 0, 1)));
        newcomer.read_until<wire::Done>();
        return counter(peer, "jobs_ended") > jobs + 20;
    }));
    CHECK(read_answer(paused) == expected);
}

TEST_CASE_FIXTURE(Hasty, "a frame that stops in the middle waits for its rest") {
    Peer guest(daemon);
    guest.greet();
    REQUIRE(guest.say(5, query_of(2 * chunk)));
    Bytes bytes = golden::wire_bytes(rays_frame(5, 0, chunk));
    const Bytes more = golden::wire_bytes(rays_frame(5, chunk, chunk));
    bytes.insert(bytes.end(), more.begin(), more.end());
    const std::size_t cuts[] = {20, 40, bytes.size() / 3, bytes.size() - 100, bytes.size()};
    std::size_t sent = 0;
    for (const std::size_t cut : cuts) {
        REQUIRE(guest.send(std::span(bytes).subspan(sent, cut - sent)));
        sent = cut;
        // Wait longer than it takes for a peer to count as paused.
        const auto begin = std::chrono::steady_clock::now();
        while (std::chrono::steady_clock::now() < begin + std::chrono::milliseconds(60))
            CHECK(peer.answers());
    }
    guest.read_until<wire::Done>();
    CHECK(guest.answers());
}

TEST_CASE("a newcomer gets the place of the connection that moved a whole frame longest ago") {
    const Daemon daemon({"--give-way-ms", "50", "--connections-max", "4"});
    Crowd crowd;
    for (int i = 0; i < 3; ++i) join(crowd, daemon);
    // Bytes that complete no frame do not count: the first peer stays the first to go.
    const Bytes ping = golden::wire_bytes(protocol::encode(1, wire::PingT{}).value());
    std::size_t sent = 0;
    REQUIRE(eventually([&] {
        if (sent + 1 < ping.size()) REQUIRE(crowd[0]->send(std::span(ping).subspan(sent++, 1)));
        Peer newcomer(daemon);
        const bool sure = newcomer.say(0, wire::HelloT{});
        const auto frame = newcomer.read();
        // The others are served meanwhile.
        for (const std::size_t i : {1U, 2U}) CHECK(crowd[i]->answers());
        return sure && frame &&
               frame->header.type == static_cast<std::uint16_t>(wire::Message::Welcome);
    }));
    CHECK(crowd[0]->read_error() == Code::slow_consumer);
    CHECK(crowd[0]->ends());
    CHECK(counter(*crowd[1], "gave_way_connections") == 1);
}

TEST_CASE("where nobody pauses a newcomer hears that the daemon is full") {
    const Daemon daemon({"--connections-max", "3", "--give-way-ms", "600000"});
    Crowd crowd;
    join(crowd, daemon);
    join(crowd, daemon);
    Peer newcomer(daemon);
    REQUIRE(newcomer.say(0, wire::HelloT{}));
    const auto frame = newcomer.read();
    REQUIRE(frame);
    const auto error = protocol::open<wire::Error>(*frame);
    REQUIRE(error);
    CHECK(static_cast<Code>((*error)->code()) == Code::busy);
    CHECK((*error)->retry_after_ms() > 0);
    CHECK(protocol::text((*error)->message()).find("no free connections") != std::string::npos);
    CHECK(newcomer.ends());
    for (const auto& guest : crowd) CHECK(guest->answers());
}

TEST_CASE("a request takes the place of one whose client pauses") {
    Hasty house({"--total-jobs-max", "3"});
    Crowd crowd;
    for (int i = 0; i < 2; ++i) {
        Peer& guest = join(crowd, house.daemon);
        REQUIRE(guest.say(5, query_of(1)));  // its ray does not come
        guest.read_until<wire::Started>();
    }
    std::uint64_t id = 5;
    REQUIRE(eventually([&] {
        REQUIRE(crowd[1]->answers());
        REQUIRE(house.peer.say(++id, query_of(1)));
        const auto frame = house.peer.read();
        REQUIRE(frame);
        return frame->header.type == static_cast<std::uint16_t>(wire::Message::Started);
    }));
    CHECK(crowd[0]->read_error() == Code::slow_consumer);
    CHECK(crowd[0]->ends());
    CHECK(crowd[1]->answers());
    CHECK(counter(house.peer, "gave_way_jobs") == 1);
}

TEST_CASE("readers that pause hold their windows, and give their memory to who needs it") {
    Hasty house({"--memory", "64M"});
    const std::uint64_t before = house.daemon.resident_bytes();
    Crowd crowd;
    constexpr std::size_t clients = 40;
    for (std::size_t i = 0; i < clients; ++i) {
        Peer& guest = join(crowd, house.daemon);
        bool started = false;
        for (std::uint64_t id = 5; !started; ++id) {
            REQUIRE(guest.say(id, large_query()));
            auto frame = guest.read();
            while (frame && frame->header.request_id != id) frame = guest.read();
            REQUIRE(frame);
            started = frame->header.type == static_cast<std::uint16_t>(wire::Message::Started);
        }
    }
    // About 8 to 13 of them fit at a time, up to 16 where sockets take a part of the answers.
    CHECK(counter(house.peer, "gave_way_memory") >= clients / 2);
    const std::uint64_t growth = house.daemon.resident_bytes_max() - before;
    if (!sanitized) CHECK(growth < 128 << 20);
    tally("readers that pause before 8 MB each", clients,
          std::to_string(growth >> 20) + " MiB of memory at most, all of them served, " +
              std::to_string(static_cast<int>(counter(house.peer, "gave_way_memory"))) +
              " gave way");
}

TEST_CASE_FIXTURE(Hasty, "a daemon that ends does not wait for those who pause") {
    REQUIRE(peer.say(5, query_of(1)));
    peer.read_until<wire::Started>();
    daemon.signal(SIGTERM);
    CHECK(peer.read_error() == Code::draining);
    CHECK(peer.ends());
    CHECK(daemon.wait() == 0);
}

}  // namespace
}  // namespace raynest::test
