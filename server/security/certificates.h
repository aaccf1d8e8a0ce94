// Makes a private CA and the certificates that it signs: `raynestd tls init` and `tls renew`.
#pragma once

#include "engine/result.h"

#include <filesystem>
#include <string>
#include <vector>

namespace raynest::server {

/// The files that make_certificates() writes into its folder.
struct CertificateFiles {
    static constexpr const char* ca = "ca.pem";
    static constexpr const char* ca_key = "ca-key.pem";
    static constexpr const char* server = "cert.pem";
    static constexpr const char* server_key = "key.pem";
    static constexpr const char* client = "client-cert.pem";
    static constexpr const char* client_key = "client-key.pem";
};

/// Returns the names and addresses under which other machines may know this host, those of loopback
/// included.
[[nodiscard]] std::vector<std::string> own_names();

/// Writes a CA, and a server and a client certificate that it signs. `names` are the host names and
/// IP addresses of the server certificate. Overwrites nothing: fails if one of the files exists.
/// Writes all files or none.
[[nodiscard]] Result<void> make_certificates(const std::filesystem::path& folder,
                                             const std::vector<std::string>& names);

struct Renewal {
    long days = 0;              ///< whole days that the new certificates are valid
    bool ends_with_ca = false;  ///< the CA ends before their usual time
};

/// Signs the server and the client certificate of the folder anew, for the same names and keys.
/// Writes both or none. Fails if a key does not belong to its certificate, if the CA has not signed
/// a certificate for this use before, if it has expired, or if another user owns its key.
[[nodiscard]] Result<Renewal> renew_certificates(const std::filesystem::path& folder);

}  // namespace raynest::server
