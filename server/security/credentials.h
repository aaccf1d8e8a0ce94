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

    bool operator==(const SecurityOptions&) const = default;
};

/// Returns who may connect by these options.
[[nodiscard]] AccessPolicy policy_of(const SecurityOptions& options);

/// Io thread only.
class Credentials {
public:
    /// `refused`, unless null, counts logins that are refused.
    explicit Credentials(const SecurityOptions& options, const protocol::Limits& limits = {},
                         Metrics::Counter* refused = nullptr);
    Credentials(const Credentials&) = delete;

    /// Reads all files. Fails with the first that is unusable.
    Result<void> load();
    /// Reads all files again, which `options` may name anew. A file that is unusable is logged, and
    /// what it said before stays; of options that changed, then none is taken. Fails with the first
    /// such file. Afterwards ask still_valid() about everybody who was admitted.
    Result<void> reload(const SecurityOptions& options);
    /// Reads the token file again if it has changed. True if rows may have changed, or rows or
    /// certificates expired since the last call: then ask still_valid() about everybody.
    bool look(WallClock::time_point now);

    /// The options that count now.
    [[nodiscard]] const SecurityOptions& options() const { return options_; }

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
    /// The token file as it was read; no rows without one.
    struct Tokens {
        TokenTable table;
        Version version;
    };
    using Tls = std::shared_ptr<const TlsContext>;

    static Version version_of(const std::filesystem::path& file);
    static Result<Tls> read_tls(const SecurityOptions& options);
    static Result<Tokens> read_tokens(const SecurityOptions& options);
    void take(Tls tls);
    void take(Tokens tokens);
    void find_next_expiry(WallClock::time_point now);

    SecurityOptions options_;
    std::shared_ptr<const TlsContext> tls_;
    Authentication authentication_;
    Version tokens_version_;
    WallClock::time_point next_expiry_ = WallClock::time_point::max();
};

}  // namespace raynest::server
