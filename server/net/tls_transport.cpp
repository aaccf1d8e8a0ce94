#include "server/net/tls_transport.h"

#include "protocol/control.h"
#include "protocol/frame.h"
#include "protocol/keep_alive.h"
#include "protocol/validate.h"
#include "server/log.h"
#include "server/net/socket_transport.h"

#include <openssl/err.h>
#include <openssl/x509.h>
#include <sys/socket.h>

#include <algorithm>
#include <cstring>
#include <span>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Payload of one TLS record.
constexpr std::size_t record_bytes = 16 << 10;
/// Encrypted bytes that OpenSSL may have taken off the socket without the rest of their record.
constexpr std::size_t record_bytes_max = record_bytes + 512;
/// Maximum bytes that a read waits for, as in socket_transport.cpp.
constexpr std::size_t low_mark_max = 128 << 10;

/// Returns the subject of the peer's certificate, which OpenSSL has verified, in the form of RFC
/// 2253: "CN=alice,O=Lab". Empty without one, or if it is not a
/// short printable text.
std::string subject_of(const SSL* tls) {
    const std::unique_ptr<X509, void (*)(X509*)> certificate(SSL_get1_peer_certificate(tls),
                                                             X509_free);
    if (!certificate || SSL_get_verify_result(tls) != X509_V_OK) return "";
    const std::unique_ptr<BIO, int (*)(BIO*)> text(BIO_new(BIO_s_mem()), BIO_free);
    X509_NAME_print_ex(text.get(), X509_get_subject_name(certificate.get()), 0,
                       XN_FLAG_RFC2253 & ~ASN1_STRFLGS_ESC_MSB);
    char* bytes = nullptr;
    const long size = BIO_get_mem_data(text.get(), &bytes);
    const std::string subject(bytes, size > 0 ? static_cast<std::size_t>(size) : 0);
    constexpr std::size_t subject_bytes_max = 200;
    return subject.size() <= subject_bytes_max && protocol::printable(subject) ? subject : "";
}

/// Copies the first bytes of `rest`, at most a record of them, and returns their number.
std::size_t gather(const WriteBatch::Rest& rest, std::span<std::byte, record_bytes> record) {
    return asio::buffer_copy(asio::buffer(record.data(), record.size()), rest);
}

}  // namespace

TlsTransport::TlsTransport(Socket socket, const TlsContext& context)
    : socket_(std::move(socket)),
      peer_(identity_of(socket_)),
      tls_(SSL_new(context.get())) {
    peer_.transport = "tls";
    protocol::tune_tcp(socket_.native_handle());
    SystemError ignored;
    socket_.non_blocking(true, ignored);
    if (tls_ == nullptr) throw std::bad_alloc();
    SSL_set_fd(tls_.get(), socket_.native_handle());
    SSL_set_accept_state(tls_.get());
}

TlsTransport::Outcome TlsTransport::outcome(int result) const {
    if (result > 0) return Outcome::done;
    switch (SSL_get_error(tls_.get(), result)) {
        case SSL_ERROR_WANT_READ:
            return Outcome::wait_read;
        case SSL_ERROR_WANT_WRITE:
            return Outcome::wait_write;
        case SSL_ERROR_ZERO_RETURN:
            return Outcome::ended;
        default:
            return Outcome::failed;
    }
}

asio::awaitable<void> TlsTransport::wait(Outcome need, SystemError& error) {
    const auto what = need == Outcome::wait_write ? Socket::wait_write : Socket::wait_read;
    co_await socket_.async_wait(what, asio::redirect_error(asio::use_awaitable, error));
    // OpenSSL knows only the number of a descriptor, and a closed one may name another file by now.
    if (!socket_.is_open()) error = asio::error::operation_aborted;
}

asio::awaitable<bool> TlsTransport::starts_plain(SystemError& error) {
    co_await socket_.async_wait(Socket::wait_read,
                                asio::redirect_error(asio::use_awaitable, error));
    unsigned char first = 0;
    constexpr unsigned char handshake_record = 0x16;
    const bool there =
        !error && recv(socket_.native_handle(), &first, 1, MSG_PEEK | MSG_DONTWAIT) == 1;
    co_return there && first != handshake_record;
}

void TlsTransport::refuse_plain() {
    std::array<std::byte, 4096> first;
    const ssize_t got = recv(socket_.native_handle(), first.data(), first.size(), MSG_DONTWAIT);
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
    (void)socket_.write_some(parts, ignored);
}

asio::awaitable<void> TlsTransport::linger() {
    SystemError error;
    socket_.shutdown(Socket::shutdown_send, error);
    std::array<std::byte, 1024> skipped;
    while (!error && socket_.is_open())
        co_await socket_.async_read_some(asio::buffer(skipped),
                                         asio::redirect_error(asio::use_awaitable, error));
}

void TlsTransport::log_failure(std::string_view why) const {
    log(LogLevel::info, "handshake_failed", {{"peer", peer_.name}, {"reason", std::string(why)}});
}

asio::awaitable<void> TlsTransport::open(SystemError& error) {
    const bool plain = co_await starts_plain(error);
    if (error) co_return;
    if (plain) {
        refuse_plain();
        log_failure("it does not speak TLS");
        co_await linger();
        error = asio::error::connection_aborted;
        co_return;
    }
    while (!error) {
        ERR_clear_error();
        const Outcome now = outcome(SSL_accept(tls_.get()));
        if (now == Outcome::done) {
            peer_.subject = subject_of(tls_.get());
            opened_ = true;
            co_return;
        }
        if (now == Outcome::ended || now == Outcome::failed) {
            log_failure(tls_error_text());
            co_await linger();  // the peer reads an alert
            error = asio::error::connection_aborted;
            co_return;
        }
        co_await wait(now, error);
    }
}

void TlsTransport::set_low_mark(std::size_t wanted) {
    // OpenSSL may hold the beginning of a record already.
    wanted = std::min(wanted, low_mark_max);
    const std::size_t mark = wanted > 2 * record_bytes_max ? wanted - record_bytes_max : 1;
    if (mark == low_mark_) return;
    low_mark_ = mark;
    const int value = static_cast<int>(mark);
    // Ignore failure: this only saves time.
    (void)setsockopt(socket_.native_handle(), SOL_SOCKET, SO_RCVLOWAT, &value, sizeof value);
}

asio::awaitable<std::size_t> TlsTransport::read(const ReadBuffers& buffers, std::size_t wanted,
                                                SystemError& error) {
    std::size_t total = 0;
    if (!socket_.is_open()) error = asio::error::operation_aborted;
    if (error) co_return 0;
    for (const asio::mutable_buffer& buffer : buffers) {
        for (std::size_t filled = 0; filled < buffer.size();) {
            ERR_clear_error();
            std::size_t got = 0;
            const Outcome now =
                outcome(SSL_read_ex(tls_.get(), static_cast<std::byte*>(buffer.data()) + filled,
                                    buffer.size() - filled, &got));
            filled += got;
            total += got;
            if (now == Outcome::done) continue;
            // The next call repeats an error.
            if (total != 0) co_return total;
            if (now == Outcome::ended) error = asio::error::eof;
            if (now == Outcome::failed) error = asio::error::connection_reset;
            if (error) co_return 0;
            set_low_mark(wanted);
            co_await wait(now, error);
            if (error) co_return 0;
        }
    }
    co_return total;
}

std::size_t TlsTransport::write_now(const WriteBatch::Rest& rest) {
    if (!opened_ || !socket_.is_open()) return 0;
    std::size_t total = 0;
    // One record's worth of small parts is copied together; OpenSSL encrypts it into a buffer of
    // its own in any case.
    static thread_local std::array<std::byte, record_bytes> record;
    WriteBatch::Rest left = rest;
    std::vector<asio::const_buffer> parts(rest.begin(), rest.end());
    while (!parts.empty()) {
        left = {parts.data(), parts.data() + parts.size()};
        const std::byte* bytes = nullptr;
        std::size_t size = 0;
        if (parts.front().size() >= record_bytes && pending_ == 0) {
            bytes = static_cast<const std::byte*>(parts.front().data());
            size = record_bytes;
        } else {
            size = gather(left, record);
            bytes = record.data();
        }
        if (pending_ != 0) size = std::min(size, pending_);
        ERR_clear_error();
        std::size_t written = 0;
        const Outcome now = outcome(SSL_write_ex(tls_.get(), bytes, size, &written));
        if (now != Outcome::done) {
            if (now == Outcome::wait_write || now == Outcome::wait_read) pending_ = size;
            break;
        }
        pending_ = 0;
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

asio::awaitable<std::size_t> TlsTransport::write(const WriteBatch::Rest& rest,
                                                 SystemError& error) {
    while (!error) {
        if (const std::size_t written = write_now(rest); written != 0) co_return written;
        if (!socket_.is_open()) error = asio::error::operation_aborted;
        if (pending_ == 0) error = asio::error::connection_reset;
        if (!error) co_await wait(Outcome::wait_write, error);
    }
    co_return 0;
}

asio::awaitable<void> TlsTransport::finish_writing() {
    ERR_clear_error();
    if (opened_ && socket_.is_open()) (void)SSL_shutdown(tls_.get());
    SystemError ignored;
    socket_.shutdown(Socket::shutdown_send, ignored);
    co_return;
}

void TlsTransport::close() {
    SystemError ignored;
    socket_.close(ignored);
}

bool TlsTransport::is_lost() {
    return peer_is_lost(socket_.native_handle());
}

}  // namespace raynest::server
