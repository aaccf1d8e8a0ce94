// Requests that wait for a takeover, or for a scene, before they begin.
#include "server/jobs/change_gate.h"
#include "tests/unit/server/small_daemon.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <chrono>
#include <vector>

namespace raynest::server {
namespace {

using test::Client;
using test::errors_of;
using test::frame_of;
using test::SmallDaemon;

TEST_CASE("a request that waits for a takeover holds up its own data, and keeps its deadline") {
    SmallDaemon daemon;
    ChangeGate gate;
    daemon.services.changes = &gate;
    Client client(daemon);
    client.receive(frame_of(0, wire::HelloT{}));
    const auto load = [](std::uint32_t deadline_ms) {
        wire::LoadT message;
        message.source = "a.gltf";
        message.file_names = {"a.gltf"};
        message.file_hashes = {1};
        message.file_bytes = {2};
        message.deadline_ms = deadline_ms;
        return message;
    };
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
    gate.open();
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
    gate.open();
    CHECK(errors_of(daemon).size() == 1);
    CHECK(daemon.said(wire::Message::Need));

    // A connection has as many as it may, and leaves nothing when it ends.
    gate.close();
    for (std::uint64_t id = 10; id < 30; ++id) client.receive(frame_of(id, load(50)));
    CHECK(errors_of(daemon).back() == Code::quota);
    client.abandon();
    CHECK(client.held_bytes() == 0);
    gate.open();
}

}  // namespace
}  // namespace raynest::server
