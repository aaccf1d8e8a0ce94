#include "client/net/connection.h"

#include "client/ground/interrupt.h"
#include "tests/unit/client/fake_daemon.h"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <memory>
#include <string>
#include <thread>
#include <vector>

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

constexpr std::byte filling{0x5a};
constexpr std::uint64_t large = 8U << 20;  // more than a socket buffers

/// Sends a request, and after it a frame that the daemon does not read.
client::Result<void> send_much(Connection& connection, std::chrono::milliseconds deadline = {}) {
    if (auto started = connection.start(info_request(), deadline); !started) return started;
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, large);
    bulk.allocate();
    std::fill_n(bulk.block(0).data(), large, filling);
    return connection.send_bulk(wire::UploadT{}, std::move(bulk));
}

/// Reads the rest of the stream.
std::vector<std::byte> rest_of(int socket) {
    std::vector<std::byte> bytes;
    std::array<std::byte, 4096> part{};
    for (ssize_t count = 0; (count = ::recv(socket, part.data(), part.size(), 0)) > 0;)
        bytes.insert(bytes.end(), part.begin(), part.begin() + count);
    return bytes;
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
    for (const int family : {AF_INET, AF_INET6})
        CHECK(exit_of_open(client::ClosedPort(family).uri()) == Exit::cannot_connect);
}

TEST_CASE("a server that cannot be meant is a usage error") {
    for (const char* uri : {"", "forest", "http://localhost:80", "tcp://localhost", "tcp://:1"})
        CHECK(exit_of_open(uri) == Exit::usage);
}

TEST_CASE("a token goes in clear text to a loopback address only, whatever the name said") {
    const auto [listener, port] = client::listen_on_every_address();
    const std::string away = client::other_address();
    if (!away.empty()) {
        const auto refused = Connection::open("tcp://" + away + ":" + port, "secret");
        REQUIRE(!refused);
        CHECK(refused.error().exit == Exit::usage);
        CHECK(refused.error().message.find("is not sent to") != std::string::npos);
        const int accepted = client::accept_one(listener);
        std::byte byte{};
        CHECK(::recv(accepted, &byte, 1, 0) == 0);
        ::close(accepted);
    }
    ::close(listener);
}

TEST_CASE("a TLS server's alert is told in words, and not tried again") {
    FakeDaemon daemon([](Peer& peer) {
        peer.receive();
        constexpr std::array<unsigned char, 7> alert = {21, 3, 1, 0, 2, 2, 70};
        peer.send_bytes(std::as_bytes(std::span(alert)));
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(!connection);
    CHECK(connection.error().exit == Exit::cannot_connect);
    CHECK(connection.error().message.find("tls:// in place of tcp://") != std::string::npos);
    CHECK_FALSE(connection.error().lost);
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

TEST_CASE("another kind of server is not mistaken for a daemon") {
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

TEST_CASE("a frame that ends its request without the answer, or a broken answer, is no hang") {
    for (const bool broken : {false, true}) {
        FakeDaemon daemon([&](Peer& peer) {
            peer.welcome();
            const std::uint64_t id = peer.receive().header.request_id;
            peer.send(id, wire::ProgressT{});
            wire::SceneInfoT info;
            info.name = "a\x1b[2J";
            if (broken)
                peer.send(id, info);
            else
                peer.send(id, wire::DoneT{});
            peer.receive();
        });
        const auto connection = Connection::open(daemon.uri(), "");
        REQUIRE(connection);
        const auto info = client::ask<wire::SceneInfo>(**connection, info_request());
        REQUIRE(!info);
        CHECK(info.error().exit == Exit::failed);
        CHECK(info.error().message.starts_with(broken ? "the daemon sent a broken SceneInfo"
                                                      : "the daemon sent Done before"));
    }
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

TEST_CASE("a daemon that goes away within an answer may have wanted the reader's place") {
    FakeDaemon daemon([](Peer& peer) {
        peer.welcome();
        peer.receive();
        peer.send_bytes(std::vector<std::byte>(7));
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(connection);
    const auto info = client::ask<wire::SceneInfo>(**connection, info_request());
    REQUIRE(!info);
    CHECK(info.error().exit == Exit::failed);
    CHECK(info.error().message.find("gave way") != std::string::npos);
}

TEST_CASE("credit for consumed bulk is granted before the window is used up") {
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
                wire::PayloadT picture;
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

TEST_CASE("a silent server is an error within the time of a greeting") {
    FakeDaemon daemon([](Peer& peer) {
        while (peer.receive().header.type != 0) {
        }
    });
    const auto connection = Connection::open(daemon.uri(), "");
    REQUIRE(!connection);
    CHECK(connection.error().exit == Exit::cannot_connect);
    CHECK(connection.error().message.find("--deadline") == std::string::npos);
}

TEST_CASE("a server that hangs up on the greeting is an error") {
    const auto [listener, path] = client::listen_somewhere();
    std::thread hanging_up([listener = listener] { ::close(client::accept_one(listener)); });
    CHECK(exit_of_open("unix:" + path) == Exit::cannot_connect);
    hanging_up.join();
    ::close(listener);
    ::unlink(path.c_str());
}

TEST_CASE("where too many wait for a Unix socket's daemon, the client waits too") {
    const auto [listener, path] = client::listen_somewhere();
    sockaddr_un address = {};
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    std::vector<int> crowd;
    int full = 0;
    while (full == 0) {
        crowd.push_back(::socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
        full = ::connect(crowd.back(), reinterpret_cast<const sockaddr*>(&address), sizeof address);
    }
    REQUIRE(errno == EAGAIN);
    std::thread daemon([listener = listener, waiting = crowd.size() - 1] {
        // Give the client time to find the socket full; it is served in any case.
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
        for (std::size_t i = 0; i < waiting; ++i) ::close(client::accept_one(listener));
        Peer(client::accept_one(listener)).welcome();
    });
    CHECK(Connection::open("unix:" + path, ""));
    daemon.join();
    for (const int socket : crowd) ::close(socket);
    ::close(listener);
    ::unlink(path.c_str());
}

TEST_CASE("the deadline is kept while a daemon reads nothing") {
    const auto [listener, path] = client::listen_somewhere();
    std::unique_ptr<Peer> peer;
    std::thread daemon([&peer, listener = listener] {
        peer = std::make_unique<Peer>(client::accept_one(listener));
        peer->welcome();
    });
    const auto connection = Connection::open("unix:" + path, "");
    daemon.join();
    REQUIRE(connection);
    const auto sent = send_much(**connection, std::chrono::milliseconds(1));
    REQUIRE(!sent);
    CHECK(sent.error().exit == Exit::deadline);
    ::close(listener);
    ::unlink(path.c_str());
}

TEST_CASE("Ctrl-C within a frame exits with 130 and puts nothing into it") {
    const auto [listener, path] = client::listen_somewhere();
    const pid_t child = ::fork();
    REQUIRE(child >= 0);
    if (child == 0) {
        client::catch_interrupts();
        const auto connection = Connection::open("unix:" + path, "");
        if (!connection) _exit(1);
        const auto sent = send_much(**connection);
        _exit(sent ? 0 : static_cast<int>(sent.error().exit));
    }
    const int socket = client::accept_one(listener);
    Peer peer(socket);
    peer.welcome();
    peer.receive();
    // A part of the next frame is here: the child is in the middle of it.
    pollfd waiting{socket, POLLIN, 0};
    REQUIRE(::poll(&waiting, 1, -1) == 1);
    ::kill(child, SIGINT);
    int status = 0;
    ::waitpid(child, &status, 0);
    CHECK(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 130);
    const std::vector<std::byte> bytes = rest_of(socket);
    REQUIRE(bytes.size() > 4096);
    CHECK(bytes.size() < large);
    CHECK(std::all_of(bytes.begin() + 4096, bytes.end(),
                      [](std::byte byte) { return byte == filling; }));
    ::close(listener);
    ::unlink(path.c_str());
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
