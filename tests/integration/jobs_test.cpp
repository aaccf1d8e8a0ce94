// Jobs of a real daemon: streamed, cancelled, abandoned, late, drained.
#include "tests/golden/examples.h"
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>
#include <signal.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace raynest::test {
namespace {

using protocol::Code;

constexpr std::uint64_t chunk = 16384;

TEST_CASE("chunks cover every ray once, under the client's credit") {
    const Daemon daemon;
    Peer peer(daemon);
    wire::HelloT hello;
    hello.window_bytes = 256 << 10;
    peer.greet(hello);
    load_scene(peer);

    constexpr std::uint64_t rays = 10 * chunk + 7;
    REQUIRE(peer.say(5, query_of(rays)));
    for (std::uint64_t first = 0; first < rays; first += chunk)
        REQUIRE(peer.send_frame(rays_frame(5, first, std::min(chunk, rays - first))));

    std::vector<int> seen(rays, 0);
    // Grant more only when a PONG shows that the daemon had time to exceed its credit.
    std::uint64_t credit = hello.window_bytes;
    bool asked = false;
    for (;;) {
        const auto frame = peer.read();
        REQUIRE(frame.has_value());
        if (frame->header.type == static_cast<std::uint16_t>(wire::Message::Done)) break;
        if (frame->header.type == static_cast<std::uint16_t>(wire::Message::Pong)) {
            wire::CreditT grant;
            grant.bytes = hello.window_bytes - std::exchange(credit, hello.window_bytes);
            REQUIRE(peer.say(5, grant));
            asked = false;
        }
        if (frame->header.type != static_cast<std::uint16_t>(wire::Message::Chunk)) continue;
        const std::uint64_t bytes = frame->header.bulk_bytes;
        REQUIRE(bytes <= credit);
        credit -= bytes;
        const auto answer = protocol::open<wire::Chunk>(*frame);
        REQUIRE(answer);
        for (std::uint64_t i = 0; i < (*answer)->count(); ++i) ++seen[(*answer)->first_ray() + i];
        for (const protocol::BlockView& block : answer->blocks)
            CHECK(block.count == (*answer)->count());
        if (credit < hello.window_bytes / 2 && !std::exchange(asked, true))
            REQUIRE(peer.say(1, wire::PingT{}));
    }
    CHECK(std::all_of(seen.begin(), seen.end(), [](int times) { return times == 1; }));
}

TEST_CASE("without credit the daemon sends no answers") {
    const Daemon daemon;
    Peer peer(daemon);
    wire::HelloT hello;
    hello.window_bytes = 64 << 10;
    peer.greet(hello);
    load_scene(peer);
    REQUIRE(peer.say(5, query_of(8 * chunk)));
    for (std::uint64_t i = 0; i < 8; ++i) REQUIRE(peer.send_frame(rays_frame(5, i * chunk, chunk)));

    std::uint64_t got = 0;
    REQUIRE(peer.say(1, wire::PingT{}));
    // A parked job only reports progress: after some data, three such frames in a row mean that
    // nothing else will come.
    for (int quiet = 0; quiet < 3 || got == 0;) {
        const auto frame = peer.read();
        REQUIRE(frame.has_value());
        got += frame->header.bulk_bytes;
        quiet = frame->header.type == static_cast<std::uint16_t>(wire::Message::Progress)
                    ? quiet + 1
                    : 0;
    }
    CHECK(got <= hello.window_bytes);
    CHECK(peer.answers());
}

TEST_CASE_FIXTURE(Served, "cancel ends a job, and the connection goes on") {
    REQUIRE(peer.say(5, endless_render()));
    peer.read_until<wire::Started>();
    REQUIRE(peer.say(5, wire::CancelT{}));
    CHECK(peer.read_error() == Code::cancelled);
    CHECK(peer.answers());
    CHECK(counter(peer, "jobs_cancelled") == 1);
}

TEST_CASE_FIXTURE(Served, "a deadline ends a job that runs and one that waits for rays") {
    wire::RenderT render = endless_render();
    render.job->deadline_ms = 50;
    REQUIRE(peer.say(5, render));
    CHECK(peer.read_error() == Code::deadline);
    wire::QueryT query = query_of(10);
    query.job->deadline_ms = 50;
    REQUIRE(peer.say(6, query));
    CHECK(peer.read_error() == Code::deadline);
    CHECK(peer.answers());
}

TEST_CASE_FIXTURE(Served, "a request id under way cannot be used again") {
    REQUIRE(peer.say(5, query_of(1)));
    REQUIRE(peer.say(5, query_of(1)));
    CHECK(peer.read_error() == Code::invalid_field);
    REQUIRE(peer.send_frame(rays_frame(5, 0, 1)));
    peer.read_until<wire::Done>();
    REQUIRE(peer.say(5, query_of(1)));
    peer.read_until<wire::Started>();
}

TEST_CASE_FIXTURE(Served, "a connection has only so many requests in flight") {
    const std::uint64_t most = protocol::Limits{}.jobs_max;
    for (std::uint64_t id = 10; id < 10 + most; ++id) REQUIRE(peer.say(id, query_of(1)));
    REQUIRE(peer.say(99, query_of(1)));
    CHECK(peer.read_error() == Code::quota);
    REQUIRE(peer.send_frame(rays_frame(10, 0, 1)));
    peer.read_until<wire::Done>();
    REQUIRE(peer.say(99, query_of(1)));
    peer.read_until<wire::Started>();
}

TEST_CASE("a principal's rays in flight are limited over all connections") {
    const Daemon daemon({"--principal-rays-max", "1000"});
    Peer peer(daemon);
    peer.greet();
    load_scene(peer);
    REQUIRE(peer.say(5, query_of(1000)));
    peer.read_until<wire::Started>();
    Peer second(daemon);
    second.greet();
    REQUIRE(second.say(5, query_of(1)));
    CHECK(second.read_error() == Code::quota);
    REQUIRE(peer.say(5, wire::CancelT{}));
    CHECK(peer.read_error() == Code::cancelled);
    REQUIRE(second.say(5, query_of(1)));
    second.read_until<wire::Started>();
}

TEST_CASE_FIXTURE(Served, "a principal has only so many requests in flight, over all connections") {
    const protocol::Limits limits;
    std::vector<std::unique_ptr<Peer>> crowd;
    for (std::uint64_t i = 0; i < limits.principal_jobs_max; ++i) {
        if (i % limits.jobs_max == 0) {
            crowd.push_back(std::make_unique<Peer>(daemon));
            crowd.back()->greet();
        }
        REQUIRE(crowd.back()->say(10 + i, query_of(1)));
        crowd.back()->read_until<wire::Started>();
    }
    REQUIRE(peer.say(5, query_of(1)));
    CHECK(peer.read_error() == Code::quota);
    crowd.clear();
    wait_for_idle(peer);
    REQUIRE(peer.say(5, query_of(1)));
    peer.read_until<wire::Started>();
}

TEST_CASE_FIXTURE(Served, "announced or unexpected bodies cost no memory") {
    const std::uint64_t before = daemon.resident_bytes();
    std::vector<std::unique_ptr<Peer>> crowd;
    for (int i = 0; i < 50; ++i) {
        Peer& guest = *crowd.emplace_back(std::make_unique<Peer>(daemon));
        guest.greet();
        // Send a whole one for an unknown request, then only the header of a large one.
        REQUIRE(guest.send_frame(rays_frame(77, 0, chunk)));
        REQUIRE(guest.say(5, query_of(chunk)));
        guest.read_until<wire::Started>();
        const protocol::Frame rays = rays_frame(5, 0, chunk);
        std::array<std::byte, protocol::header_bytes> header{};
        protocol::write_header(rays.header, header);
        REQUIRE(guest.send(header));
        REQUIRE(guest.send(rays.control.span()));
    }
    if (!sanitized) CHECK(daemon.resident_bytes() < before + 50 * (64 << 10));
    CHECK(peer.answers());
}

TEST_CASE_FIXTURE(Served, "waiting frames of rays take memory for their rays only") {
    // Nobody grants credit for the answers, so the rays wait; their control part is padded to its
    // limit.
    wire::HelloT hello;
    hello.window_bytes = 64 << 10;
    Peer guest(daemon);
    guest.greet(hello);
    constexpr std::uint64_t frames = 4000;
    REQUIRE(guest.say(5, query_of(2 * frames)));
    const std::uint64_t before = daemon.resident_bytes();
    for (std::uint64_t i = 0; i < frames; ++i) {
        protocol::Frame rays = rays_frame(5, 2 * i, 2);
        protocol::Buffer control(protocol::Limits{}.control_bytes_max);
        std::memset(control.data(), 0, control.size());
        std::memcpy(control.data(), rays.control.data(), rays.control.size());
        rays.control = std::move(control);
        rays.header.control_bytes = static_cast<std::uint32_t>(rays.control.size());
        REQUIRE(guest.send_frame(rays));
    }
    REQUIRE(guest.answers());
    const std::uint64_t growth = daemon.resident_bytes() - before;
    if (!sanitized) CHECK(growth < 16 << 20);
    tally("frames of two rays and 64 KiB of control", frames,
          std::to_string(growth >> 20) + " MiB of memory");
}

TEST_CASE("answers that nobody reads stay within --memory, after their jobs too") {
    Served house({"--memory", "64M", "--give-way-ms", "600000"});
    const std::uint64_t before = house.daemon.resident_bytes();
    wire::QueryT query = query_of(0);
    query.kind = "null";
    query.fields = {"t", "prim", "geom", "path", "uv", "position", "ng"};
    query.generator = std::make_unique<wire::GeneratorT>();
    query.generator->kind = "equirectangular";
    query.generator->settings = {"size=380x380"};
    std::vector<std::unique_ptr<Peer>> crowd;
    constexpr std::size_t clients = 60;
    std::size_t refused = 0;
    for (std::size_t i = 0; i < clients; ++i) {
        Peer& guest = *crowd.emplace_back(std::make_unique<Peer>(house.daemon));
        guest.greet();
        REQUIRE(guest.say(5, query));
        wait_for_idle(house.peer);
        refused = static_cast<std::size_t>(counter(house.peer, "jobs_refused"));
    }
    CHECK(refused > clients / 2);
    CHECK(refused < clients - 4);
    const std::uint64_t growth = house.daemon.resident_bytes_max() - before;
    if (!sanitized) CHECK(growth < 96 << 20);
    crowd.clear();
    // Unread answers are freed.
    CHECK(eventually([&] { return counter(house.peer, "memory_used_bytes") < 1 << 20; }));
    tally("clients that read no answer of 8 MB", clients,
          std::to_string(refused) + " refused, " + std::to_string(growth >> 20) +
              " MiB of memory at most of 64");
}

TEST_CASE("rays beyond the credit end their query") {
    const Daemon daemon;
    Peer peer(daemon);
    wire::HelloT hello;
    hello.window_bytes = 64 << 10;
    peer.greet(hello);
    load_scene(peer);
    // Answers are parked for lack of credit, so the rays are not processed either.
    constexpr std::uint64_t frames = 40;
    REQUIRE(peer.say(5, query_of(frames * chunk)));
    for (std::uint64_t i = 0; i < frames; ++i)
        REQUIRE(peer.send_frame(rays_frame(5, i * chunk, chunk)));
    CHECK(peer.read_error() == Code::limit_exceeded);
    CHECK(peer.answers());
}

/// Waits for a drain, which a client sees when it makes a new request. Uses ids from 100 on.
void wait_for_drain(Peer& peer) {
    std::uint64_t id = 100;
    REQUIRE(eventually([&] {
        REQUIRE(peer.say(++id, query_of(1)));
        auto frame = peer.read();
        while (frame && frame->header.request_id != id) frame = peer.read();
        REQUIRE(frame.has_value());
        const auto error = protocol::open<wire::Error>(*frame);
        if (error && static_cast<Code>((*error)->code()) == Code::draining) return true;
        REQUIRE(peer.say(id, wire::CancelT{}));
        CHECK(peer.read_error() == Code::cancelled);
        return false;
    }));
}

TEST_CASE_FIXTURE(Served, "SIGTERM lets running jobs end, refuses new ones, and exits with 0") {
    REQUIRE(peer.say(5, query_of(2)));
    peer.read_until<wire::Started>();
    daemon.signal(SIGTERM);
    wait_for_drain(peer);
    REQUIRE(peer.send_frame(rays_frame(5, 0, 2)));
    peer.read_until<wire::Chunk>();
    peer.read_until<wire::Done>();
    CHECK(peer.read_error() == Code::draining);
    CHECK(peer.ends());
    CHECK(daemon.wait() == 0);
}

TEST_CASE_FIXTURE(Served, "a second SIGTERM ends the daemon at once with code 3") {
    REQUIRE(peer.say(5, endless_render()));
    peer.read_until<wire::Started>();
    daemon.signal(SIGTERM);
    // The render goes on; only a second signal ends it, and it must come after the first was
    // handled.
    wait_for_drain(peer);
    peer.read_until<wire::Progress>();
    daemon.signal(SIGTERM);
    CHECK(daemon.wait() == 3);
}

}  // namespace
}  // namespace raynest::test
