#include "server/net/tls_transport.h"

#include "protocol/control.h"
#include "protocol/frame.h"
#include "server/ground/io_turn.h"
#include "server/ground/limited_log.h"
#include "server/net/socket_transport.h"

#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Maximum bytes that a read waits for, as in socket_transport.cpp.
constexpr std::size_t low_mark_max = 128 << 10;

}  // namespace

TlsTransport::TlsTransport(Socket socket, const TlsContext& context)
    : tls_(std::move(socket), context),
      peer_(identity_of(tls_.socket())) {
    peer_.transport = "tls";
}

void TlsTransport::refuse_plain() {
    Socket& socket = tls_.socket();
    std::array<std::byte, 4096> first;
    const ssize_t got = recv(socket.native_handle(), first.data(), first.size(), MSG_DONTWAIT);
    if (got < 4 || std::memcmp(first.data(), "RYN1", 4) != 0) return;
    const protocol::Frame frame = protocol::encode_error(
        0,
        {Code::bad_frame, "this port is encrypted: connect to it with tls:// in place of tcp://",
         0},
        true);
    std::array<std::byte, protocol::header_bytes> header;
    protocol::write_header(frame.header, header);
    const std::array<asio::const_buffer, 2> parts = {
        asio::buffer(header), asio::buffer(frame.control.data(), frame.control.size())};
    SystemError ignored;
    (void)socket.write_some(parts, ignored);
}

void TlsTransport::log_failure(std::string_view why) const {
    log_limited(LogLevel::info, "handshake_failed", peer_.name,
                {{"peer", peer_.whereabouts()}, {"reason", std::string(why)}});
}

asio::awaitable<void> TlsTransport::open(SystemError& error) {
    const bool plain = co_await tls_.starts_plain(error);
    if (error) co_return;
    if (plain) {
        refuse_plain();
        log_failure("it does not speak TLS");
        co_await tls_.linger();
        error = asio::error::connection_aborted;
        co_return;
    }
    std::string why;
    co_await tls_.accept(error, why, peer_.name);
    if (!why.empty()) log_failure(why);
    if (!error) tls_.tell_subject(peer_);
}

void TlsTransport::set_low_mark(std::size_t wanted) {
    // OpenSSL may hold the beginning of a record already.
    constexpr std::size_t held_max = TlsSocket::record_bytes_max;
    wanted = std::min(wanted, low_mark_max);
    const std::size_t mark = wanted > 2 * held_max ? wanted - held_max : 1;
    if (mark == low_mark_) return;
    low_mark_ = mark;
    const int value = static_cast<int>(mark);
    // Ignore failure: this only saves time.
    (void)setsockopt(tls_.socket().native_handle(), SOL_SOCKET, SO_RCVLOWAT, &value, sizeof value);
}

asio::awaitable<std::size_t> TlsTransport::read(const ReadBuffers& buffers, std::size_t wanted,
                                                SystemError& error) {
    std::size_t total = 0;
    if (!tls_.socket().is_open()) error = asio::error::operation_aborted;
    if (error) co_return 0;
    auto began = Clock::now() - kept_;
    for (const asio::mutable_buffer& buffer : buffers) {
        for (std::size_t filled = 0; filled < buffer.size();) {
            // A peer may send a record for each byte, and faster than they can be decrypted.
            if (kept_ >= turn_time) {
                if (total != 0) co_return total;
                co_await yield(error);
                if (error) co_return 0;
                began = Clock::now();
            }
            std::size_t got = 0;
            const Outcome now = tls_.read(static_cast<std::byte*>(buffer.data()) + filled,
                                          buffer.size() - filled, got);
            kept_ = Clock::now() - began;
            filled += got;
            total += got;
            if (now == Outcome::done) continue;
            // The next call repeats an error.
            if (total != 0) co_return total;
            if (now == Outcome::ended) error = asio::error::eof;
            if (now == Outcome::failed) error = asio::error::connection_reset;
            if (error) co_return 0;
            set_low_mark(wanted);
            co_await tls_.wait(now, error);
            kept_ = {};
            co_return 0;  // to decrypt takes long
        }
    }
    co_return total;
}

asio::awaitable<void> TlsTransport::yield(SystemError& error) {
    kept_ = {};
    co_await asio::post(tls_.socket().get_executor(), asio::use_awaitable);
    if (!tls_.socket().is_open()) error = asio::error::operation_aborted;
}

std::size_t TlsTransport::write_now(const WriteBatch::Rest& rest) {
    std::size_t total = 0;
    std::vector<asio::const_buffer> parts(rest.begin(), rest.end());
    while (!parts.empty()) {
        // Small parts are copied into one record; OpenSSL encrypts into a buffer of its own in any
        // case.
        const bool is_large = parts.front().size() >= TlsSocket::record_bytes && !tls_.has_unsent();
        const WriteBatch::Rest left{parts.data(), parts.data() + parts.size()};
        std::size_t written = 0;
        const Outcome now = is_large
                                ? tls_.write(parts.front().data(), TlsSocket::record_bytes, written)
                                : tls_.write_some(left, written);
        if (now != Outcome::done) break;
        total += written;
        while (written != 0) {
            const std::size_t taken = std::min(written, parts.front().size());
            parts.front() += taken;
            written -= taken;
            if (parts.front().size() == 0) parts.erase(parts.begin());
        }
        while (!parts.empty() && parts.front().size() == 0) parts.erase(parts.begin());
    }
    return total;
}

asio::awaitable<std::size_t> TlsTransport::write(const WriteBatch::Rest& rest, SystemError& error) {
    while (!error) {
        if (const std::size_t written = write_now(rest); written != 0) co_return written;
        if (!tls_.socket().is_open()) error = asio::error::operation_aborted;
        if (!tls_.has_unsent()) error = asio::error::connection_reset;
        if (!error) co_await tls_.wait(Outcome::wait_write, error);
    }
    co_return 0;
}

asio::awaitable<void> TlsTransport::finish_writing() {
    tls_.finish_writing();
    co_return;
}

void TlsTransport::close() {
    SystemError ignored;
    tls_.socket().close(ignored);
}

bool TlsTransport::has_left() {
    return peer_has_left(tls_.socket().native_handle());
}

bool TlsTransport::is_lost() {
    return peer_is_lost(tls_.socket().native_handle());
}

}  // namespace raynest::server
