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
};

/// State that connections share: certificate, key and allowed versions. Immutable; a connection keeps
/// the one that it began with.
class TlsContext {
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

private:
    TlsContext() = default;

    std::unique_ptr<SSL_CTX, protocol::Release<SSL_CTX_free>> context_;
    std::chrono::system_clock::time_point expires_;
    std::vector<std::string> names_;
};

}  // namespace raynest::server
