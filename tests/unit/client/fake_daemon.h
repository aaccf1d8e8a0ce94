// A minimal daemon for the client's tests: a Unix socket, the frame decoder, and a script.
#pragma once

#include "protocol/control.h"

#include <functional>
#include <string>
#include <thread>
#include <utility>

namespace raynest::client {

/// The daemon's end of one connection. Failures end the test through doctest.
class Peer {
public:
    explicit Peer(int socket) : socket_(socket) {}
    ~Peer();
    Peer(const Peer&) = delete;
    Peer& operator=(const Peer&) = delete;

    /// Returns the next frame; an empty one (type 0) at the end of the stream.
    protocol::Frame receive();
    void send(const protocol::Frame& frame);
    template <class Native>
    void send(std::uint64_t id, const Native& message) {
        send(protocol::encode(id, message).value());
    }
    template <class Native>
    void send(std::uint64_t id, Native message, protocol::Bulk bulk) {
        send(protocol::encode(id, std::move(message), std::move(bulk)).value());
    }
    void send_bytes(std::span<const std::byte> bytes);
    /// Reads the client's Hello and answers with a Welcome of this window.
    void welcome(std::uint64_t window_bytes = 8U << 20, std::uint32_t chunk_rays_max = 16U << 10);

private:
    int socket_;
    protocol::Limits limits_;
    protocol::FrameDecoder decoder_{limits_};
};

/// Listens at once. Runs `script` for one connection in a thread of its own, which the destructor
/// joins.
class FakeDaemon {
public:
    explicit FakeDaemon(std::function<void(Peer&)> script);
    ~FakeDaemon();
    FakeDaemon(const FakeDaemon&) = delete;
    FakeDaemon& operator=(const FakeDaemon&) = delete;
    [[nodiscard]] std::string uri() const { return "unix:" + path_; }

private:
    std::string path_;
    int listener_ = -1;
    std::thread thread_;
};

/// A TCP port of this machine that nobody listens on, and nobody can meanwhile.
class ClosedPort {
public:
    /// `family` is AF_INET or AF_INET6.
    explicit ClosedPort(int family);
    ~ClosedPort();
    ClosedPort(const ClosedPort&) = delete;
    ClosedPort& operator=(const ClosedPort&) = delete;
    [[nodiscard]] const std::string& uri() const { return uri_; }

private:
    int socket_ = -1;
    std::string uri_;
};

/// Returns a listening Unix socket in the temporary folder, for tests that accept by themselves.
std::pair<int, std::string> listen_somewhere();
/// Returns a listening TCP socket of all addresses, and its port.
std::pair<int, std::string> listen_on_every_address();
/// Returns an IPv4 address of this machine that is not the loopback's, or "".
std::string other_address();
/// Returns the next connection of a listener, or -1 when patience ends.
int accept_one(int listener);

}  // namespace raynest::client
