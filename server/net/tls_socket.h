// A TCP socket with TLS: the handshake, and reads and writes that never wait.
//
// OpenSSL reads and writes the socket itself, and Asio only waits for it: through memory buffers
// each byte would be copied twice more, and an idle connection would keep 68 KiB of them.
#pragma once

#include "server/net/asio.h"
#include "server/net/minute_limit.h"
#include "server/security/principal.h"
#include "server/security/tls_context.h"

#include <array>
#include <cstddef>
#include <memory>
#include <string>

namespace raynest::server {

/// The server's end of a TLS connection. Io thread only.
class TlsSocket {
public:
    enum class Outcome { done, wait_read, wait_write, ended, failed };

    /// Payload of one TLS record.
    static constexpr std::size_t record_bytes = 16 << 10;
    /// Encrypted bytes that OpenSSL may have taken off the socket without the rest of their record.
    static constexpr std::size_t record_bytes_max = record_bytes + 512;

    TlsSocket(Socket socket, const TlsContext& context);
    TlsSocket(const TlsSocket&) = delete;

    [[nodiscard]] Socket& socket() { return socket_; }

    /// Waits for the first bytes; true if they are not those of TLS.
    asio::awaitable<bool> starts_plain(SystemError& error);
    /// Does the handshake, in turns of the peer's address. Fails with the reason in `why`, after the
    /// peer could read an alert.
    asio::awaitable<void> accept(SystemError& error, std::string& why, const std::string& address);
    /// Tells `peer` the subject of its certificate, which OpenSSL has verified, in the form of RFC
    /// 2253: "CN=alice,O=Lab"; or why that names no principal. Without a certificate it tells
    /// nothing.
    void tell_subject(PeerIdentity& peer) const;

    /// Decrypts bytes that are there. `got` is 0 unless the outcome is `done`.
    Outcome read(void* bytes, std::size_t size, std::size_t& got);
    /// Encrypts and sends at most a record of these bytes. After wait_read or wait_write the same
    /// bytes must come again, perhaps at another address, and more may follow them.
    Outcome write(const void* bytes, std::size_t size, std::size_t& written);
    /// Encrypts and sends the first bytes of the buffers, at most a record, as one record.
    template <class Buffers>
    Outcome write_some(const Buffers& buffers, std::size_t& written) {
        auto& record = scratch();
        return write(record.data(), asio::buffer_copy(asio::buffer(record), buffers), written);
    }
    /// True while OpenSSL wants bytes of a write again.
    [[nodiscard]] bool has_unsent() const { return unsent_ != 0; }
    /// True if received bytes wait in OpenSSL, perhaps a part of a record.
    [[nodiscard]] bool has_bytes() const { return SSL_has_pending(tls_.get()) == 1; }

    /// Waits until the socket is ready for what `need` says.
    asio::awaitable<void> wait(Outcome need, SystemError& error);
    /// Tells the peer that no more bytes follow.
    void finish_writing();
    /// Lets the peer read the last bytes: closing with unread ones would reset the connection. Ends
    /// with the peer's end, or when the socket is closed.
    asio::awaitable<void> linger();

private:
    [[nodiscard]] Outcome outcome(int result) const;
    /// OpenSSL calls it for each message and alert. It must not throw.
    static void take_message(int is_sent, int version, int type, const void* bytes,
                             std::size_t size, SSL* tls, void* self) noexcept;
    /// A record of bytes that a write gathers.
    static std::array<std::byte, record_bytes>& scratch();

    Socket socket_;
    const std::shared_ptr<const TlsContext> context_;
    std::unique_ptr<SSL, protocol::Release<SSL_free>> tls_;
    std::size_t unsent_ = 0;  ///< bytes of a write that OpenSSL wants again
    bool accepted_ = false;
    /// Messages of TLS itself after the handshake, such as new keys. OpenSSL handles all that are
    /// there in one call, and each costs as much as a hundred bytes of payload.
    MinuteLimit messages_;
};

}  // namespace raynest::server
