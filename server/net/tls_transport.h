// The transport over TLS on a TCP socket.
//
// OpenSSL reads and writes the socket itself, and Asio only waits for it: through memory buffers
// each byte would be copied twice more, and an idle connection would keep 68 KiB of them.
#pragma once

#include "server/net/transport.h"
#include "server/security/tls_context.h"

#include <memory>
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
    asio::awaitable<void> finish_writing() override;
    void close() override;
    bool is_lost() override;

private:
    struct Free {
        void operator()(SSL* tls) const { SSL_free(tls); }
    };
    enum class Outcome { done, wait_read, wait_write, ended, failed };
    [[nodiscard]] Outcome outcome(int result) const;
    asio::awaitable<void> wait(Outcome need, SystemError& error);
    /// Answers a client that does not speak TLS in its own language, and ends the connection.
    void refuse_plain();
    /// Waits for the first bytes; true if they are not those of TLS.
    asio::awaitable<bool> starts_plain(SystemError& error);
    /// Lets the peer read the last bytes: closing with unread ones would reset the connection. Ends
    /// with the peer's end, or at the session's deadline.
    asio::awaitable<void> linger();
    void set_low_mark(std::size_t wanted);
    void log_failure(std::string_view why) const;

    Socket socket_;
    PeerIdentity peer_;
    std::unique_ptr<SSL, Free> tls_;
    std::size_t pending_ = 0;   ///< bytes of a write that OpenSSL wants to repeat
    std::size_t low_mark_ = 1;  ///< encrypted bytes that wake up a read
    bool opened_ = false;
};

}  // namespace raynest::server
