// The credentials of a client and its demands on a daemon: token, certificates, and the CA to
// trust.
#pragma once

#include "client/ground/failure.h"

#include <string>
#include <vector>

namespace raynest::client {

/// How tls:// is checked.
struct TlsOptions {
    std::string ca;           ///< PEM file of the CAs to trust; empty: the system's store
    std::string certificate;  ///< PEM file of the client's own certificate; empty: none
    std::string key;          ///< PEM file of its key
    bool verify = true;       ///< false: any certificate will do, also an attacker's
};

struct Access {
    std::string token;  ///< empty: none
    TlsOptions tls;
    std::vector<std::string> warnings = {};  ///< sentences about hosts.toml, for the user
};

/// The options of access, as the command line gives them.
struct AccessOptions {
    TlsOptions tls;
    std::string token_file;
};

/// Looks up what the options leave out: RAYNEST_CA, RAYNEST_CERT, RAYNEST_KEY and RAYNEST_TOKEN,
/// then the daemon's entry in hosts.toml (`raynest login`). Fails with a token file that others can
/// read, and rather than show a token to the network.
Result<Access> find_access(const std::string& uri, const AccessOptions& options);

/// Fails if this token would be sent where others can read it: over tcp:// to a name other than
/// `localhost`, or to an address that is not the loopback's. Connection::open() then fails with
/// not_secret() where the name of localhost leads elsewhere.
Result<void> check_secrecy(const std::string& uri, const std::string& token);
[[nodiscard]] tl::unexpected<Failure> not_secret(const std::string& uri);

}  // namespace raynest::client
