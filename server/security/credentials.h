// The certificates and tokens of a running daemon: read at the start, watched and read again.
//
// A file that became unusable changes nothing: the daemon goes on with what it had, and says so.
#pragma once

#include "server/security/authentication.h"
#include "server/security/tls_context.h"

#include <sys/stat.h>

#include <filesystem>
#include <memory>
#include <optional>

namespace raynest::server {

/// The options of security, as the command line and the configuration file give them.
struct SecurityOptions {
    TlsFiles tls;                                ///< empty paths: no TLS listener
    std::filesystem::path tokens;                ///< empty: no tokens
    std::optional<Role> anonymous = Role::user;  ///< role of peers without a token; empty: none
    bool insecure = false;                       ///< plain TCP beyond loopback is wanted
};

/// Io thread only.
class Credentials {
public:
    explicit Credentials(const SecurityOptions& options, const protocol::Limits& limits = {});

    /// Reads all files. Fails with the first that is unusable.
    Result<void> load();
    /// Reads all files again, which `options` may name anew; logs those that are unusable and keeps
    /// what they said before. Fails with the first of them.
    Result<void> reload(const SecurityOptions& options);
    /// Reads the token file again if it has changed. True if rows may have changed or expired since
    /// the last call: open connections must be checked.
    bool look_at_tokens(WallClock::time_point now);

    [[nodiscard]] Authentication& authentication() { return authentication_; }
    [[nodiscard]] const std::shared_ptr<const TlsContext>& tls() const { return tls_; }
    /// Returns the days until the certificate's time ends; nothing without a certificate.
    [[nodiscard]] std::optional<double> certificate_days_left(WallClock::time_point now) const;

private:
    /// Tells versions of a file apart.
    struct Version {
        dev_t device = 0;
        ino_t file = 0;
        off_t size = 0;
        std::int64_t changed_ns = 0;
        bool operator==(const Version&) const = default;
    };
    static Version version_of(const std::filesystem::path& file);
    static AccessPolicy policy_of(const SecurityOptions& options);
    Result<void> load_tls();
    Result<void> load_tokens();

    SecurityOptions options_;
    std::shared_ptr<const TlsContext> tls_;
    Authentication authentication_;
    Version tokens_version_;
    WallClock::time_point next_expiry_ = WallClock::time_point::max();
};

}  // namespace raynest::server
