// The transport over stream sockets, TCP and Unix.
#pragma once

#include "server/net/transport.h"

namespace raynest::server {

/// True if the machine or network at the other end of a TCP socket no longer answers.
[[nodiscard]] bool peer_is_lost(int descriptor);
/// True if the other end of a socket is closed.
[[nodiscard]] bool peer_has_left(int descriptor);

/// A connection over TCP or a Unix socket.
class SocketTransport final : public Transport {
public:
    explicit SocketTransport(Socket socket);

    [[nodiscard]] const PeerIdentity& peer() const override { return peer_; }
    asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t wanted,
                                      SystemError& error) override;
    asio::awaitable<std::size_t> write(const WriteBatch::Rest& rest, SystemError& error) override;
    std::size_t write_now(const WriteBatch::Rest& rest) override;
    asio::awaitable<void> finish_writing() override;
    void close() override;
    bool is_lost() override { return peer_is_lost(socket_.native_handle()); }
    bool has_left() override { return peer_has_left(socket_.native_handle()); }

private:
    Socket socket_;
    const PeerIdentity peer_;
    std::size_t wanted_ = 1;  ///< bytes that must be there before a read returns
};

/// Returns the identity of a peer by its address. All loopback addresses count as "127.0.0.1": any
/// program may use any of them. An IPv6 address counts as its /64, all of which one machine may
/// use.
[[nodiscard]] PeerIdentity identity_of(asio::ip::address address);

/// Returns the user at the other end of a Unix socket, e.g. "uid:1000", or else the peer's address.
[[nodiscard]] PeerIdentity identity_of(Socket& socket);

/// Returns the address at the other end of a TCP socket, an IPv4 one as such even where the socket
/// is of IPv6; nothing if it has none.
[[nodiscard]] std::optional<asio::ip::address> remote_address(Socket& socket);

}  // namespace raynest::server
