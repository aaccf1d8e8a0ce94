#include "server/net/tls_socket.h"

#include "protocol/keep_alive.h"
#include "protocol/subject.h"
#include "protocol/validate.h"
#include "server/ground/io_turn.h"
#include "server/ground/limited_log.h"
#include "server/net/socket_transport.h"
#include "server/net/turns.h"
#include "server/security/pem_file.h"

#include <fmt/format.h>
#include <openssl/err.h>
#include <openssl/x509.h>
#include <sys/socket.h>

#include <algorithm>
#include <new>
#include <utility>

namespace raynest::server {
namespace {

/// Messages of TLS itself after the handshake, in a minute; one more ends the connection. Clients
/// send new keys after millions of records, and none asks for another handshake, which is refused.
constexpr unsigned messages_max = 64;

}  // namespace

TlsSocket::TlsSocket(Socket socket, const TlsContext& context)
    : socket_(std::move(socket)),
      context_(context.shared_from_this()),
      tls_(SSL_new(context.get())),
      messages_(messages_max) {
    protocol::tune_tcp(socket_.native_handle());
    SystemError ignored;
    socket_.non_blocking(true, ignored);
    if (tls_ == nullptr) throw std::bad_alloc();
    SSL_set_msg_callback(tls_.get(), take_message);
    SSL_set_msg_callback_arg(tls_.get(), this);
    SSL_set_fd(tls_.get(), socket_.native_handle());
    SSL_set_accept_state(tls_.get());
}

std::array<std::byte, TlsSocket::record_bytes>& TlsSocket::scratch() {
    static thread_local std::array<std::byte, record_bytes> record;
    return record;
}

void TlsSocket::tell_subject(PeerIdentity& peer) const {
    auto certificate = context_->certificate_of(tls_.get());
    if (certificate == nullptr) return;
    const std::unique_ptr<BIO, protocol::Release<BIO_free>> text(BIO_new(BIO_s_mem()));
    X509_NAME_print_ex(text.get(), X509_get_subject_name(certificate->chain.front().get()), 0,
                       XN_FLAG_RFC2253 & ~ASN1_STRFLGS_ESC_MSB);
    char* bytes = nullptr;
    const long size = BIO_get_mem_data(text.get(), &bytes);
    std::string subject(bytes, size > 0 ? static_cast<std::size_t>(size) : 0);
    if (subject.empty())
        peer.subject_fault = "is empty";
    else if (subject.size() > protocol::subject_bytes_max)
        peer.subject_fault = "is over " + std::to_string(protocol::subject_bytes_max) + " bytes";
    else if (!protocol::printable(subject))
        peer.subject_fault = "is not printable text";
    else {
        peer.subject = std::move(subject);
        peer.certificate = std::move(certificate);
    }
}

void TlsSocket::take_message(int is_sent, int /*version*/, int type, const void* /*bytes*/,
                             std::size_t /*size*/, SSL* tls, void* self) noexcept {
    auto& socket = *static_cast<TlsSocket*>(self);
    if (is_sent != 0 || !socket.accepted_ || (type != SSL3_RT_HANDSHAKE && type != SSL3_RT_ALERT))
        return;
    socket.messages_.count(MinuteLimit::Clock::now());
    // As if the peer had ended the connection: OpenSSL then looks at no more records.
    if (socket.messages_.is_over()) SSL_set_shutdown(tls, SSL_RECEIVED_SHUTDOWN);
}

TlsSocket::Outcome TlsSocket::outcome(int result) const {
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

asio::awaitable<void> TlsSocket::wait(Outcome need, SystemError& error) {
    const auto what = need == Outcome::wait_write ? Socket::wait_write : Socket::wait_read;
    co_await socket_.async_wait(what, asio::redirect_error(asio::use_awaitable, error));
    // OpenSSL knows only the number of a descriptor, and a closed one may name another file by now.
    if (!socket_.is_open()) error = asio::error::operation_aborted;
}

asio::awaitable<bool> TlsSocket::starts_plain(SystemError& error) {
    co_await socket_.async_wait(Socket::wait_read,
                                asio::redirect_error(asio::use_awaitable, error));
    unsigned char first = 0;
    constexpr unsigned char handshake_record = 0x16;
    const bool there =
        !error && recv(socket_.native_handle(), &first, 1, MSG_PEEK | MSG_DONTWAIT) == 1;
    co_return there&& first != handshake_record;
}

asio::awaitable<void> TlsSocket::accept(SystemError& error, std::string& why,
                                        const std::string& address) {
    Turns& turns = Turns::of(socket_);
    while (!error) {
        if (turns.is_over(address)) co_await turns.wait(address);
        if (!socket_.is_open()) error = asio::error::operation_aborted;
        if (error) co_return;
        IoTurn::does("TLS handshake");
        ERR_clear_error();
        const auto began = Turns::Clock::now();
        const Outcome now = outcome(SSL_accept(tls_.get()));
        turns.spend(address, Turns::Clock::now() - began);
        accepted_ = now == Outcome::done;
        if (accepted_) co_return;
        if (now == Outcome::ended || now == Outcome::failed) {
            why = tls_error_text();
            co_await linger();  // the peer reads an alert
            error = asio::error::connection_aborted;
            co_return;
        }
        co_await wait(now, error);
    }
}

TlsSocket::Outcome TlsSocket::read(void* bytes, std::size_t size, std::size_t& got) {
    got = 0;
    if (!socket_.is_open()) return Outcome::failed;
    ERR_clear_error();
    const Outcome now = outcome(SSL_read_ex(tls_.get(), bytes, size, &got));
    if (!messages_.is_over()) return now;
    const PeerIdentity peer = identity_of(socket_);
    log_limited(LogLevel::info, "dropped", peer.name,
                {{"peer", peer.whereabouts()},
                 {"reason", fmt::format("more than {} messages of TLS itself came in a minute",
                                        messages_.most())}});
    got = 0;
    return Outcome::failed;
}

TlsSocket::Outcome TlsSocket::write(const void* bytes, std::size_t size, std::size_t& written) {
    written = 0;
    if (!accepted_ || !socket_.is_open()) return Outcome::failed;
    size = std::min(size, unsent_ != 0 ? unsent_ : record_bytes);
    ERR_clear_error();
    const Outcome now = outcome(SSL_write_ex(tls_.get(), bytes, size, &written));
    unsent_ = now == Outcome::wait_write || now == Outcome::wait_read ? size : 0;
    return now;
}

void TlsSocket::finish_writing() {
    ERR_clear_error();
    if (accepted_ && socket_.is_open()) (void)SSL_shutdown(tls_.get());
    SystemError ignored;
    socket_.shutdown(Socket::shutdown_send, ignored);
}

asio::awaitable<void> TlsSocket::linger() {
    SystemError error;
    socket_.shutdown(Socket::shutdown_send, error);
    std::array<std::byte, 1024> skipped;
    while (!error && socket_.is_open())
        co_await socket_.async_read_some(asio::buffer(skipped),
                                         asio::redirect_error(asio::use_awaitable, error));
}

}  // namespace raynest::server
