// The certificates and tokens of a running daemon: read at the start, watched and read again.
//
//   files ──read(), any thread──► Files ──take(), io thread──► who is admitted from now on
//
// To read them takes long where they are large or on a slow disk, and the io thread serves everybody.
// A file that became unusable changes nothing: the daemon goes on with what it had, and says so.
#pragma once

#include "server/security/authentication.h"
#include "server/security/tls_context.h"

#include <sys/stat.h>

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

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

    /// The content of the files that some options name, or why one is unusable.
    class Files;
    /// Reads all files. Any thread.
    [[nodiscard]] static Files read(const SecurityOptions& options);
    /// Reads the token file alone. Any thread.
    [[nodiscard]] static Files read_tokens(const SecurityOptions& options);

    /// Reads all files. Fails with the first that is unusable.
    Result<void> load();
    /// Takes what was read, and its options. A file that is unusable is logged, and what it said
    /// before stays; of options that changed, then none is taken. Fails with the first such file.
    /// Afterwards ask still_valid() about everybody who was admitted.
    Result<void> take(Files files);
    /// True if the token file is another than the one that was taken last, or the last could not be
    /// taken: read it and take it. A file that is written in place is told once two calls find it the
    /// same. Of two that are read at a time, the older may be taken last, and is found by the next
    /// call.
    [[nodiscard]] bool tokens_changed();
    /// True if rows or certificates have expired since the last call: then ask still_valid() about
    /// everybody.
    [[nodiscard]] bool any_expired(WallClock::time_point now);
    /// Sets what frees rows that are not needed any more: there may be many.
    void set_disposal(std::function<void(std::shared_ptr<const void>)> dispose) {
        dispose_ = std::move(dispose);
    }

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
        std::shared_ptr<const TokenTable> table = std::make_shared<TokenTable>();
        Version version = {};
    };
    using Tls = std::shared_ptr<const TlsContext>;

    static Version version_of(const std::filesystem::path& file);
    static Result<Tls> tls_of(const SecurityOptions& options);
    static Result<Tokens> tokens_of(const SecurityOptions& options);
    /// Logs why the token file is unusable, once for as long as the reason is the same.
    Result<Tokens> logged_once(Result<Tokens> tokens);
    void take(Tls tls);
    void take(Tokens tokens);

    SecurityOptions options_;
    std::shared_ptr<const TlsContext> tls_;
    Authentication authentication_;
    Version tokens_version_;     ///< of the table that was taken
    Version tokens_seen_;        ///< at the last look
    std::string tokens_reason_;  ///< why the file is unusable; empty: it is not
    WallClock::time_point next_expiry_ = WallClock::time_point::max();
    std::function<void(std::shared_ptr<const void>)> dispose_ = [](const auto&) {};
};

class Credentials::Files {
public:
    [[nodiscard]] const SecurityOptions& options() const { return options_; }

private:
    friend class Credentials;
    SecurityOptions options_;
    std::optional<Result<Tls>> tls_;  ///< empty: they were not read
    Result<Tokens> tokens_;
};

}  // namespace raynest::server
