// Frames over a stream socket: TCP and Unix.
#pragma once

#include "server/net/transport.h"

namespace raynest::server {

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
    bool is_lost() override;

private:
    Socket socket_;
    const PeerIdentity peer_;
    std::size_t wanted_ = 1;  ///< bytes that wake a read up
};

/// The user of a Unix socket's other end, "uid:1000", else the address of the peer. All of loopback
/// is one, "127.0.0.1": any program may use any of its addresses, so they tell nobody apart.
[[nodiscard]] PeerIdentity identity_of(Socket& socket);

}  // namespace raynest::server
