// Requests that wait for a takeover, or for a scene, before they begin.
#include "server/jobs/change_gate.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using test::Client;
using test::errors_of;
using test::frame_of;
using test::SmallDaemon;

/// A turn that others have in between is none in these tests.
const Post at_once = [](const std::function<void()>& next) { next(); };

wire::LoadT load_of(std::uint64_t bytes, std::uint32_t deadline_ms = 0) {
    wire::LoadT message;
    message.source = "a.gltf";
    message.file_names = {"a.gltf"};
    message.file_hashes = {1};
    message.file_bytes = {bytes};
    message.deadline_ms = deadline_ms;
    return message;
}

TEST_CASE("a request that waits for a takeover holds up its own data, and keeps its deadline") {
    SmallDaemon daemon;
    ChangeGate gate;
    daemon.services.changes = &gate;
    Client client(daemon);
    client.receive(frame_of(0, wire::HelloT{}));
    const auto load = [](std::uint32_t deadline_ms) { return load_of(2, deadline_ms); };
    const Clock::time_point before = Clock::now();
    gate.close();
    client.receive(frame_of(1, load(1000)));
    client.receive(frame_of(2, load(0)));
    client.receive(frame_of(3, load(0)));
    CHECK(client.held_bytes() > 0);

    // Others of the connection go on, but none under an id in use.
    daemon.sent.clear();
    client.receive(frame_of(9, wire::PingT{}));
    client.receive(frame_of(2, wire::PingT{}));
    client.receive(frame_of(2, wire::InfoT{}));
    CHECK_FALSE(client.is_held_up());
    CHECK(std::count_if(daemon.sent.begin(), daemon.sent.end(), [](const protocol::Frame& frame) {
              return frame.header.type == static_cast<std::uint16_t>(wire::Message::Pong);
          }) == 2);
    CHECK(errors_of(daemon) == std::vector{Code::invalid_field});

    daemon.sent.clear();
    client.receive(frame_of(2, wire::CancelT{}));
    CHECK(errors_of(daemon) == std::vector{Code::cancelled});

    daemon.sent.clear();
    CHECK(client.next_deadline() >= before + std::chrono::seconds(1));
    client.expire_parked(before + std::chrono::milliseconds(999));
    CHECK(daemon.sent.empty());
    client.expire_parked(client.next_deadline());
    CHECK(errors_of(daemon) == std::vector{Code::deadline});
    CHECK(client.next_deadline() == Clock::time_point::max());

    // Data of the one that still waits.
    bool resumed = false;
    client.set_resumed([&] { resumed = true; });
    CHECK_FALSE(client.is_held_up());
    client.receive(frame_of(3, wire::CreditT{}));
    CHECK(client.is_held_up());
    daemon.sent.clear();
    gate.open(at_once);
    CHECK(resumed);
    CHECK_FALSE(client.is_held_up());
    CHECK(daemon.said(wire::Message::Need));

    // Damaged data end the request that waits for them, and no other.
    gate.close();
    client.receive(frame_of(4, load(0)));
    client.receive(frame_of(5, load(0)));
    daemon.sent.clear();
    client.refuse_unreadable({static_cast<std::uint16_t>(wire::Message::Upload),
                              4,
                              {Code::invalid_field, "damaged", 0}});
    CHECK(errors_of(daemon) == std::vector{Code::invalid_field});
    gate.open(at_once);
    CHECK(errors_of(daemon).size() == 1);
    CHECK(daemon.said(wire::Message::Need));

    // A connection has as many as it may, and leaves nothing when it ends.
    gate.close();
    for (std::uint64_t id = 10; id < 30; ++id) client.receive(frame_of(id, load(50)));
    CHECK(errors_of(daemon).back() == Code::quota);
    client.abandon();
    CHECK(client.held_bytes() == 0);
    gate.open(at_once);
}

TEST_CASE("data on their way to a parked request have memory, or end it where memory is full") {
    SmallDaemon daemon;
    const std::uint64_t idle = daemon.used_bytes();
    ChangeGate gate;
    daemon.services.changes = &gate;
    Client client(daemon);
    client.receive(frame_of(0, wire::HelloT{}));
    constexpr std::uint64_t size = 1 << 20;
    const auto load = [] { return load_of(2 * size); };
    const auto piece = [](std::uint64_t id) {
        protocol::Bulk bulk;
        bulk.add("data", wire::Dtype::u8, 1, size);
        bulk.allocate();
        std::fill_n(bulk.block(0).data(), size, std::byte{0});
        return protocol::encode(id, wire::UploadT{}, std::move(bulk)).value();
    };
    gate.close();
    client.receive(frame_of(1, load()));
    const std::uint64_t parked = client.held_bytes();
    CHECK(client.admit(piece(1).header) == true);
    CHECK(client.held_bytes() == parked + size);
    CHECK(daemon.budget.used() == idle + client.held_bytes());

    SUBCASE("held up, they keep it until their request has begun and taken them") {
        client.receive(piece(1));
        CHECK(client.is_held_up());
        CHECK(client.held_bytes() == parked + size);
        gate.open(at_once);
        CHECK_FALSE(client.is_held_up());
        CHECK(client.held_bytes() == 3 * size);  // all data of the job, and its file so far
        client.receive(frame_of(1, wire::CancelT{}));
        daemon.settle();
        CHECK(client.held_bytes() == 0);
    }
    SUBCASE("half here, they keep it when their request has ended") {
        client.expire_parked(client.next_deadline());
        CHECK(errors_of(daemon) == std::vector{Code::deadline});
        CHECK(client.held_bytes() == size);
        CHECK(client.waits_for_client());
        client.receive(piece(1));
        CHECK(client.held_bytes() == 0);
    }
    SUBCASE("refused, they cost their request alone") {
        client.receive(piece(1));
        gate.open(at_once);
        client.receive(frame_of(1, wire::CancelT{}));
        daemon.settle();
        gate.close();
        client.receive(frame_of(2, load()));
        const auto rest =
            daemon.budget.reserve(daemon.budget.limit() - daemon.budget.used() - size / 2);
        REQUIRE(rest);
        daemon.sent.clear();
        protocol::Frame skipped = piece(2);
        CHECK(client.admit(skipped.header) == false);
        CHECK(errors_of(daemon) == std::vector{Code::resource_exhausted});
        CHECK(client.held_bytes() == 0);
        skipped.bulk = {};
        client.receive(std::move(skipped));
        CHECK(errors_of(daemon).size() == 1);
        CHECK_FALSE(client.closing());
    }
    CHECK(daemon.used_bytes() == idle);
    gate.open(at_once);
}

TEST_CASE("requests that wait have places among those in flight, of their principal and in all") {
    protocol::Limits limits;
    limits.principal_jobs_max = 3;
    SmallDaemon daemon(limits);
    ChangeGate gate;
    daemon.services.changes = &gate;
    gate.close();
    const auto& in_flight = daemon.admission.jobs();
    {
        Client one(daemon), two(daemon), other(daemon, "you");
        for (Client* client : {&one, &two, &other}) client->receive(frame_of(0, wire::HelloT{}));
        one.receive(frame_of(1, load_of(2)));
        one.receive(frame_of(2, load_of(2)));
        two.receive(frame_of(1, load_of(2)));
        CHECK(errors_of(daemon).empty());
        two.receive(frame_of(2, load_of(2)));
        CHECK(errors_of(daemon) == std::vector{Code::quota});
        other.receive(frame_of(1, load_of(2)));
        CHECK(errors_of(daemon).size() == 1);
        CHECK(in_flight.size() == 4);

        // One that is told by its number to end, one that its client cancels, and one whose client
        // leaves give up their places.
        const auto cancel = in_flight.begin()->second.cancel;
        CHECK(in_flight.begin()->second.detail == "Load");
        cancel();
        CHECK(errors_of(daemon) == std::vector{Code::quota, Code::cancelled});
        CHECK(in_flight.size() == 3);
        cancel();
        two.receive(frame_of(1, wire::CancelT{}));
        other.abandon();
        CHECK(errors_of(daemon).size() == 3);
        CHECK(in_flight.size() == 1);

        // The last one begins in its own place.
        gate.open(at_once);
        CHECK(in_flight.size() == 1);
        CHECK(in_flight.begin()->second.kind == "load");
        CHECK(daemon.said(wire::Message::Need));
    }
    daemon.settle();
    CHECK(in_flight.empty());
}

TEST_CASE("those who wait for one thing go on in turns of the io thread") {
    Waiters waiters;
    std::vector<std::shared_ptr<Waiters::Awake>> all;
    std::size_t woken = 0;
    for (int i = 0; i < 5; ++i) {
        all.push_back(std::make_shared<Waiters::Awake>([&](const Reply<void>& result) {
            CHECK_FALSE(result.has_value());
            ++woken;
            // As long as a turn may take.
            for (const auto end = Clock::now() + turn_time; Clock::now() < end;) {
            }
        }));
        waiters.add(all.back());
    }
    std::deque<std::function<void()>> turns;
    const Post post = [&](std::function<void()> next) { turns.push_back(std::move(next)); };
    auto kept = std::make_shared<int>();
    waiters.wake_all(refuse(Code::busy, "no"), post, kept);
    // It has come too late for these turns, and one leaves before its own.
    waiters.add(all.front());
    all[2].reset();
    for (std::size_t turn = 1; turn <= 4; ++turn) {
        CHECK(woken == turn);
        CHECK(turns.size() == (turn == 4 ? 0 : 1));
        CHECK(kept.use_count() == (turn == 4 ? 1 : 2));
        if (turns.empty()) break;
        const auto next = std::move(turns.front());
        turns.pop_front();
        next();
    }
    CHECK(waiters.size() == 1);
}

}  // namespace
}  // namespace raynest::server
