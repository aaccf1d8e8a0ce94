// The transport over TLS on a TCP socket.
#pragma once

#include "server/net/tls_socket.h"
#include "server/net/transport.h"

#include <chrono>
#include <cstddef>
#include <string_view>

namespace raynest::server {

/// A connection over TLS.
class TlsTransport final : public Transport {
public:
    TlsTransport(Socket socket, const TlsContext& context);

    /// Known before the handshake but for the certificate's subject.
    [[nodiscard]] const PeerIdentity& peer() const override { return peer_; }
    asio::awaitable<void> open(SystemError& error) override;
    asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t wanted,
                                      SystemError& error) override;
    asio::awaitable<std::size_t> write(const WriteBatch::Rest& rest, SystemError& error) override;
    std::size_t write_now(const WriteBatch::Rest& rest) override;
    [[nodiscard]] bool reads_take_time() const override { return true; }
    asio::awaitable<void> finish_writing() override;
    void close() override;
    bool is_lost() override;
    bool has_left() override;

private:
    using Outcome = TlsSocket::Outcome;
    using Clock = std::chrono::steady_clock;
    /// Answers a client that does not speak TLS in its own language.
    void refuse_plain();
    void set_low_mark(std::size_t wanted);
    void log_failure(std::string_view why) const;
    /// Lets other connections have their turn.
    asio::awaitable<void> yield(SystemError& error);

    TlsSocket tls_;
    PeerIdentity peer_;
    std::size_t low_mark_ = 1;  ///< encrypted bytes that wake up a read
    Clock::duration kept_{0};   ///< for how long it has decrypted in this turn
};

}  // namespace raynest::server
