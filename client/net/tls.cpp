#include "client/net/tls.h"

#include "protocol/openssl.h"

#include <arpa/inet.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace raynest::client {
namespace {

/// Encrypted bytes that one read of a socket takes, and that one write sends.
constexpr std::size_t read_ahead_bytes = 64 << 10;
constexpr int write_bytes = 256 << 10;

using Settings = std::unique_ptr<SSL_CTX, protocol::Release<SSL_CTX_free>>;

/// The reason of OpenSSL's first error in this thread; clears them all.
std::string error_text() {
    return protocol::openssl_error_text("the connection ended");
}

/// Fails with the reason if a file of an option is not there or cannot be read.
Result<void> check_readable(const std::string& file) {
    struct stat status {};
    const char* why = nullptr;
    if (::stat(file.c_str(), &status) != 0 || ::access(file.c_str(), R_OK) != 0)
        why = std::strerror(errno);
    else if (S_ISDIR(status.st_mode))
        why = "it is a folder";
    return why == nullptr ? Result<void>() : fail(Exit::usage, "cannot read " + file + ": " + why);
}

Result<Settings> make_context(const TlsOptions& options) {
    for (const std::string& file : {options.ca, options.certificate, options.key})
        if (!file.empty())
            if (auto readable = check_readable(file); !readable)
                return tl::unexpected<Failure>(readable.error());
    ERR_clear_error();
    Settings context(SSL_CTX_new(TLS_client_method()));
    if (!context) return fail(Exit::failed, error_text());
    SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
    SSL_CTX_set_options(context.get(), SSL_OP_NO_COMPRESSION | SSL_OP_NO_RENEGOTIATION);
    SSL_CTX_set_mode(context.get(),
                     SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
    // One read of the socket takes several records: else each takes two.
    SSL_CTX_set_read_ahead(context.get(), 1);
    SSL_CTX_set_default_read_buffer_len(context.get(), read_ahead_bytes);
    const bool trusts = options.ca.empty()
                            ? SSL_CTX_set_default_verify_paths(context.get()) == 1
                            : SSL_CTX_load_verify_file(context.get(), options.ca.c_str()) == 1;
    if (!trusts)
        return fail(Exit::usage, options.ca +
                                     ": there is no CA certificate in PEM form in it; it is the "
                                     "ca.pem of: raynestd tls init DIR");
    SSL_CTX_set_verify(context.get(), options.verify ? SSL_VERIFY_PEER : SSL_VERIFY_NONE, nullptr);
    if (options.certificate.empty()) return context;
    if (SSL_CTX_use_certificate_chain_file(context.get(), options.certificate.c_str()) != 1)
        return fail(Exit::usage, options.certificate + ": " +
                                     (ERR_GET_LIB(ERR_peek_error()) == ERR_LIB_PEM
                                          ? "there is no certificate in PEM form in it"
                                          : "the certificate cannot be used: " + error_text()));
    if (SSL_CTX_use_PrivateKey_file(context.get(), options.key.c_str(), SSL_FILETYPE_PEM) != 1)
        return fail(Exit::usage, options.key + ": there is no key in it that fits " +
                                     options.certificate + " (" + error_text() + ")");
    return context;
}

bool expect_host(SSL* tls, const std::string& host) {
    in6_addr storage{};
    const bool is_address = inet_pton(AF_INET, host.c_str(), &storage) == 1 ||
                            inet_pton(AF_INET6, host.c_str(), &storage) == 1;
    if (is_address) return X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(tls), host.c_str()) == 1;
    // OpenSSL's macro for the name of the server casts in the old style.
    return SSL_set1_host(tls, host.c_str()) == 1 &&
           SSL_ctrl(tls, SSL_CTRL_SET_TLSEXT_HOSTNAME, TLSEXT_NAMETYPE_host_name,
                    const_cast<char*>(host.c_str())) == 1;
}

/// True for alerts by which a daemon refuses this client's certificate.
bool refuses_certificate(int reason) {
    switch (reason) {
        case SSL_R_SSLV3_ALERT_BAD_CERTIFICATE:
        case SSL_R_SSLV3_ALERT_CERTIFICATE_EXPIRED:
        case SSL_R_SSLV3_ALERT_CERTIFICATE_REVOKED:
        case SSL_R_SSLV3_ALERT_CERTIFICATE_UNKNOWN:
        case SSL_R_SSLV3_ALERT_UNSUPPORTED_CERTIFICATE:
        case SSL_R_TLSV1_ALERT_UNKNOWN_CA:
        case SSL_R_TLSV1_ALERT_ACCESS_DENIED:
        case SSL_R_TLSV13_ALERT_CERTIFICATE_REQUIRED:
            return true;
        default:
            return false;
    }
}

/// Says why the stream broke, from OpenSSL's errors of this thread.
Failure broken() {
    const int reason = ERR_GET_REASON(ERR_peek_error());
    if (refuses_certificate(reason))
        return failure(Exit::not_allowed,
                       "the daemon refuses this client's certificate (" + error_text() +
                           "); give --cert and --key of a CA that its --client-ca names");
    return failure(Exit::failed, "the connection broke: " + error_text());
}

/// Explains a handshake that failed.
Failure unverified(const SSL* tls, const std::string& host) {
    const long verdict = SSL_get_verify_result(tls);
    const std::string why = X509_verify_cert_error_string(verdict);
    if (verdict == X509_V_ERR_HOSTNAME_MISMATCH || verdict == X509_V_ERR_IP_ADDRESS_MISMATCH)
        return failure(Exit::cannot_connect,
                       "the daemon's certificate is not for " + host +
                           "; connect by a name that it has, or make one with: raynestd tls init "
                           "DIR --host " +
                           host);
    if (verdict == X509_V_ERR_CERT_HAS_EXPIRED)
        return failure(Exit::cannot_connect,
                       "the daemon's certificate has expired; on its machine: raynestd tls renew "
                       "DIR, then SIGHUP");
    if (verdict != X509_V_OK)
        return failure(Exit::cannot_connect,
                       "no CA known here has signed the daemon's certificate (" + why +
                           "); pass --ca FILE or set RAYNEST_CA to its ca.pem");
    const int reason = ERR_GET_REASON(ERR_peek_error());
    if (reason == SSL_R_WRONG_VERSION_NUMBER || reason == SSL_R_HTTP_REQUEST ||
        reason == SSL_R_UNSUPPORTED_PROTOCOL)
        return failure(Exit::cannot_connect, "what listens there does not speak TLS (" +
                                                 error_text() +
                                                 "); is it tcp:// in place of tls://?");
    Failure why_not = broken();
    if (why_not.exit == Exit::failed) {
        why_not =
            failure(Exit::cannot_connect, "no RayNest daemon answers on TLS; " + why_not.message);
    }
    return why_not;
}

}  // namespace

struct TlsStream::Parts {
    Settings context;
    std::unique_ptr<SSL, protocol::Release<SSL_free>> tls;
};

TlsStream::TlsStream(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

TlsStream::~TlsStream() = default;

Result<std::unique_ptr<TlsStream>> TlsStream::open(int socket, const std::string& host,
                                                   const TlsOptions& options, const Wait& wait) {
    auto context = make_context(options);
    if (!context) return tl::unexpected<Failure>(context.error());
    auto parts = std::make_unique<Parts>();
    parts->context = std::move(*context);
    parts->tls.reset(SSL_new(parts->context.get()));
    SSL* tls = parts->tls.get();
    if (tls == nullptr || SSL_set_fd(tls, socket) != 1 || !expect_host(tls, host))
        return fail(Exit::failed, "cannot begin TLS with " + host + ": " + error_text());
    SSL_set_connect_state(tls);
    while (true) {
        ERR_clear_error();
        const int result = SSL_do_handshake(tls);
        if (result == 1) break;
        const int need = SSL_get_error(tls, result);
        if (need != SSL_ERROR_WANT_READ && need != SSL_ERROR_WANT_WRITE)
            return tl::unexpected<Failure>(unverified(tls, host));
        if (auto ready = wait(need == SSL_ERROR_WANT_READ ? POLLIN : POLLOUT); !ready)
            return tl::unexpected<Failure>(ready.error());
    }
    // One write of the socket sends several records.
    BIO* gathered = BIO_new(BIO_f_buffer());
    if (gathered == nullptr || BIO_set_write_buffer_size(gathered, write_bytes) != 1)
        return fail(Exit::failed, "cannot begin TLS with " + host + ": " + error_text());
    BIO* socket_bio = SSL_get_wbio(tls);
    BIO_up_ref(socket_bio);
    SSL_set0_wbio(tls, BIO_push(gathered, socket_bio));
    return std::unique_ptr<TlsStream>(new TlsStream(std::move(parts)));
}

TlsStream::State TlsStream::state_of(int result) {
    if (result > 0) return State::ready;
    switch (SSL_get_error(parts_->tls.get(), result)) {
        case SSL_ERROR_WANT_READ:
        case SSL_ERROR_WANT_WRITE:
            return State::wait;
        case SSL_ERROR_ZERO_RETURN:
            return State::ended;
        default:
            failure_ = broken();
            return State::broken;
    }
}

TlsStream::Moved TlsStream::read(std::span<std::byte> buffer) {
    Moved moved;
    while (moved.bytes < buffer.size() && moved.state == State::ready) {
        ERR_clear_error();
        std::size_t count = 0;
        moved.state = state_of(SSL_read_ex(parts_->tls.get(), buffer.data() + moved.bytes,
                                           buffer.size() - moved.bytes, &count));
        moved.bytes += count;
    }
    drained_ = moved.state == State::wait;
    return moved;
}

TlsStream::Moved TlsStream::write(std::span<const std::byte> bytes) {
    Moved moved;
    while (moved.bytes < bytes.size() && moved.state == State::ready) {
        ERR_clear_error();
        std::size_t count = 0;
        moved.state = state_of(SSL_write_ex(parts_->tls.get(), bytes.data() + moved.bytes,
                                            bytes.size() - moved.bytes, &count));
        moved.bytes += count;
    }
    if (moved.state == State::broken) return moved;
    BIO* gathered = SSL_get_wbio(parts_->tls.get());
    is_flushed_ = BIO_flush(gathered) == 1;
    if (!is_flushed_ && BIO_should_retry(gathered) == 0) {
        failure_ = broken();
        return {0, State::broken};
    }
    return moved;
}

bool TlsStream::has_bytes() const {
    // What waits after a read that found too little is a part of a record.
    return !drained_ && SSL_has_pending(parts_->tls.get()) == 1;
}

}  // namespace raynest::client
