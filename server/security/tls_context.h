// The certificate and key of the daemon's TLS listeners. Only server/security,
// server/net/tls_socket.cpp and protocol/openssl.h include OpenSSL.
#pragma once

#include "engine/result.h"
#include "protocol/openssl.h"

#include <openssl/ssl.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {

/// The files of a TLS listener.
struct TlsFiles {
    std::filesystem::path certificate;  ///< PEM: the certificate, then those up to its CA
    std::filesystem::path key;          ///< PEM; others must not be able to read it
    std::filesystem::path client_ca;    ///< PEM: CAs of client certificates; empty: none count

    bool operator==(const TlsFiles&) const = default;
};

class TlsContext;

/// The certificate of a client, as its handshake has verified it. Io thread only.
struct ClientCertificate {
    std::vector<std::shared_ptr<X509>> chain;  ///< the client's own first
    std::chrono::system_clock::time_point expires;
    /// The context that has verified it last: a reload costs each certificate one more time, and
    /// not each time that somebody asks who is still admitted.
    mutable std::shared_ptr<const TlsContext> verified_by;
};

/// State that connections share: certificate, key and allowed versions. Immutable; a connection
/// keeps the one that it began with.
class TlsContext : public std::enable_shared_from_this<TlsContext> {
public:
    /// Reads the files. Fails with the name of the file and the remedy: unreadable, too large,
    /// readable by others, expired, a key with a password or one that does not fit its certificate.
    static Result<std::shared_ptr<const TlsContext>> load(const TlsFiles& files);

    /// OpenSSL's context, which it counts references of.
    [[nodiscard]] SSL_CTX* get() const { return context_.get(); }
    /// The end of the certificate's time.
    [[nodiscard]] std::chrono::system_clock::time_point expires() const { return expires_; }
    /// The host names and IP addresses of the certificate; names may begin with "*.".
    [[nodiscard]] const std::vector<std::string>& names() const { return names_; }

    /// Returns the certificate that the peer of a handshake has shown; null without one that was
    /// verified.
    [[nodiscard]] std::shared_ptr<const ClientCertificate> certificate_of(SSL* connection) const;
    /// True if a handshake would verify the certificate now: a CA of --client-ca signed it, and it
    /// has not expired.
    [[nodiscard]] bool trusts(const ClientCertificate& certificate,
                              std::chrono::system_clock::time_point now) const;

private:
    TlsContext() = default;

    std::unique_ptr<SSL_CTX, protocol::Release<SSL_CTX_free>> context_;
    std::chrono::system_clock::time_point expires_;
    std::vector<std::string> names_;
};

}  // namespace raynest::server
