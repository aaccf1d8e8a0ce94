#include "client/connection.h"

#include "client/interrupt.h"
#include "tests/unit/client/fake_daemon.h"

#include <doctest/doctest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <string>

using namespace raynest;
using client::Connection;
using client::FakeDaemon;
using client::Peer;
using protocol::Exit;

namespace {

wire::InfoT info_request() {
    wire::InfoT request;
    request.scene = "forest";
    return request;
}

Exit exit_of_open(const std::string& uri) {
    const auto connection = Connection::open(uri, "");
    REQUIRE(!connection);
    return connection.error().exit;
}

}  // namespace

TEST_CASE("where no daemon is, the exit code is 3") {
    CHECK(exit_of_open("unix:/nonexistent/raynest.sock") == Exit::cannot_connect);
    CHECK(exit_of_open("unix:" + std::string(300, 'x')) == Exit::cannot_connect);
    CHECK(exit_of_open("tcp://127.0.0.1:1") == Exit::cannot_connect);
    CHECK(exit_of_open("tcp://[::1]:1") == Exit::cannot_connect);
}

TEST_CASE("a server that cannot be meant is a usage error") {
    for (const char* uri : {"", "forest", "http://localhost:80", "tcp://localhost", "tcp://:1"})
        CHECK(exit_of_open(uri) == Exit::usage);
}

TEST_CASE("the greeting brings the daemon's limits") {
    FakeDaemon daemon([](Peer& peer) { peer.welcome(1U << 20, 1000); });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(connection);
    CHECK((*connection)->daemon().name == "fake");
    CHECK((*connection)->daemon().window_bytes == 1U << 20);
    CHECK((*connection)->daemon().chunk_rays_max == 1000);
}

TEST_CASE("a refused greeting keeps the daemon's words and exit code") {
    for (const auto& [code, exit] :
         {std::pair{protocol::Code::not_allowed, Exit::not_allowed},
          std::pair{protocol::Code::unsupported_version, Exit::cannot_connect},
          std::pair{protocol::Code::draining, Exit::busy}}) {
        FakeDaemon daemon([code = code](Peer& peer) {
            peer.receive();
            peer.send(protocol::encode_error(0, {code, "not you", 0}, true));
        });
        const auto connection = Connection::open(daemon.uri(), "secret");
        REQUIRE(!connection);
        CHECK(connection.error().exit == exit);
        CHECK(connection.error().message == "not you");
    }
}

TEST_CASE("something else that listens is not taken for a daemon") {
    FakeDaemon daemon([](Peer& peer) {
        peer.receive();
        const std::string text = "HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n";
        peer.send_bytes(std::as_bytes(std::span(text)));
    });
    CHECK(exit_of_open(daemon.uri()) == Exit::cannot_connect);
}

TEST_CASE("an error frame becomes a failure with the table's exit code") {
    FakeDaemon daemon([](Peer& peer) {
        peer.welcome();
        const std::uint64_t id = peer.receive().header.request_id;
        peer.send(protocol::encode_error(id, {protocol::Code::busy, "full", 250}, false));
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(connection);
    const auto info = client::ask<wire::SceneInfo>(**connection, info_request());
    REQUIRE(!info);
    CHECK(info.error().exit == Exit::busy);
    CHECK(info.error().name == "BUSY");
    CHECK(info.error().retry_after_ms == 250);
}

TEST_CASE("answers of an earlier request are skipped") {
    FakeDaemon daemon([](Peer& peer) {
        peer.welcome();
        const std::uint64_t id = peer.receive().header.request_id;
        wire::SceneInfoT stale;
        stale.name = "stale";
        peer.send(id + 1, stale);
        peer.send(id - 1, stale);
        wire::SceneInfoT fresh;
        fresh.name = "fresh";
        peer.send(id, fresh);
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(connection);
    const auto info = client::ask<wire::SceneInfo>(**connection, info_request());
    REQUIRE(info);
    CHECK(protocol::text((*info)->name()) == "fresh");
}

TEST_CASE("a daemon that goes away is a failure, not a hang") {
    FakeDaemon daemon([](Peer& peer) {
        peer.welcome();
        peer.receive();
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(connection);
    const auto info = client::ask<wire::SceneInfo>(**connection, info_request());
    REQUIRE(!info);
    CHECK(info.error().exit == Exit::failed);
    CHECK(info.error().message == "the daemon closed the connection");
}

TEST_CASE("consumed bulk is granted again before the window is used up") {
    constexpr std::uint64_t piece = 1U << 20;
    std::uint64_t granted = 0;
    {
        FakeDaemon daemon([&granted](Peer& peer) {
            peer.welcome();
            const std::uint64_t id = peer.receive().header.request_id;
            for (int i = 0; i < 8; ++i) {
                protocol::Bulk bulk;
                bulk.add("data", wire::Dtype::u8, 1, piece);
                bulk.allocate();
                std::memset(bulk.block(0).data(), 0, piece);
                wire::PictureT picture;
                picture.width = picture.height = 1;
                peer.send(id, std::move(picture), std::move(bulk));
            }
            peer.send(id, wire::DoneT{});
            while (true) {
                const protocol::Frame frame = peer.receive();
                if (frame.header.type == 0) return;
                const auto credit = protocol::open<wire::Credit>(frame);
                if (credit && frame.header.request_id == id) granted += (*credit)->bytes();
            }
        });
        const auto connection = Connection::open(daemon.uri(), "");
        REQUIRE(connection);
        REQUIRE(client::ask<wire::Done>(**connection, info_request()));
    }
    CHECK(granted >= 6 * piece);
    CHECK(granted <= 8 * piece);
}

TEST_CASE("Ctrl-C cancels the request at the daemon and exits with 130") {
    const auto [listener, path] = client::listen_somewhere();
    const pid_t child = ::fork();
    REQUIRE(child >= 0);
    if (child == 0) {
        client::catch_interrupts();
        const auto connection = Connection::open("unix:" + path, "");
        if (!connection) _exit(1);
        const auto info = client::ask<wire::SceneInfo>(**connection, info_request());
        _exit(info ? 0 : static_cast<int>(info.error().exit));
    }
    {
        Peer peer(client::accept_one(listener));
        peer.welcome();
        const std::uint64_t id = peer.receive().header.request_id;
        ::kill(child, SIGINT);
        const protocol::Frame cancel = peer.receive();
        CHECK(cancel.header.request_id == id);
        CHECK(protocol::open<wire::Cancel>(cancel).has_value());
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    CHECK(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 130);
    ::close(listener);
    ::unlink(path.c_str());
}
