// Certificates and keys in PEM files. Each file is read whole, within pem_bytes_max, before OpenSSL
// sees it: a pipe or a device cannot hold the reader up, and no password is asked for.
#pragma once

#include "engine/result.h"
#include "protocol/openssl.h"
#include "server/security/secret_file.h"

#include <openssl/evp.h>
#include <openssl/x509.h>

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

namespace raynest::server {

/// Maximum size of a file of certificates or of a key.
inline constexpr std::size_t pem_bytes_max = 1 << 20;

using Key = std::unique_ptr<EVP_PKEY, protocol::Release<EVP_PKEY_free>>;
using Certificate = std::unique_ptr<X509, protocol::Release<X509_free>>;

/// Reads all certificates of a file, in their order; at least one.
[[nodiscard]] Result<std::vector<Certificate>> read_certificates(const std::filesystem::path& file);

/// Reads a key, which others must not be able to read. Fails if it has a password.
[[nodiscard]] Result<Key> read_key(const std::filesystem::path& file, Reader reader);

/// The same for files whose place was found.
[[nodiscard]] Result<std::vector<Certificate>> read_certificates(const FilePlace& place);
[[nodiscard]] Result<Key> read_key(const FilePlace& place, Reader reader);

/// The error for a file that is read and of no use.
[[nodiscard]] tl::unexpected<Error> unusable(const std::filesystem::path& file,
                                             const std::string& why);

/// The reason of OpenSSL's first error in this thread; clears them all.
[[nodiscard]] inline std::string tls_error_text() {
    return protocol::openssl_error_text("OpenSSL does not say why");
}

}  // namespace raynest::server
