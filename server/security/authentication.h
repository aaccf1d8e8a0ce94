// Decides who a peer is, from its transport and its Hello.
//
//   a token                     the principal and role of its row in the token file
//   a client certificate        its subject; the role of its row, else user; none if it was revoked
//   a Unix socket               uid:N; admin for the daemon's own user and root, else --anonymous
//   plain loopback              127.0.0.1; --anonymous
//   plain TCP beyond loopback   its address; --anonymous, but a token where there is a token file
//   TLS                         as plain TCP where neither --tokens nor --client-ca is given
//   the page                    the principal of its cookie (page_logins.h); without one
//   --anonymous for a
//                               local request, and nobody for others (http/sender.h)
#pragma once

#include "server/ground/metrics.h"
#include "server/security/page_logins.h"
#include "server/security/principal.h"
#include "server/security/tokens.h"

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>

namespace raynest::server {

/// Says who may connect without a token, and what others must show.
struct AccessPolicy {
    std::optional<Role> anonymous = Role::user;  ///< empty: nobody
    bool tokens = false;                         ///< --tokens is given
    bool certificates = false;                   ///< --client-ca is given
};

/// Returns the role of a peer that shows neither a token nor a certificate; nothing: it is refused.
[[nodiscard]] std::optional<Role> role_without(const AccessPolicy& policy,
                                               PeerIdentity::Place place,
                                               std::string_view transport);

/// Counts wrong tokens per address. After a few, other wrong ones of the address must wait, twice
/// as long each time. Right ones never wait: programs of several users may share the address.
class LoginFailures {
public:
    using Time = std::chrono::steady_clock::time_point;
    /// Returns how long wrong tokens of the address must wait; zero if they need not.
    [[nodiscard]] std::chrono::milliseconds wait_of(const std::string& address, Time now) const;
    void failed(const std::string& address, Time now);
    /// A right token came from the address: programs of several users may share it.
    void succeeded(const std::string& address) { addresses_.erase(address); }

private:
    struct Entry {
        unsigned failures = 0;
        Time last;
    };
    std::map<std::string, Entry> addresses_;
};

/// Io thread only.
class Authentication {
public:
    using Time = std::chrono::steady_clock::time_point;
    /// True if a certificate that was verified at its handshake would be verified now.
    using Trust = std::function<bool(const ClientCertificate&, WallClock::time_point)>;

    /// `refused`, unless null, counts logins that are refused.
    explicit Authentication(const AccessPolicy& policy = {}, const protocol::Limits& limits = {},
                            Metrics::Counter* refused = nullptr)
        : policy_(policy),
          logins_(limits),
          refused_(refused) {}

    // After each of these, ask still_valid() about everybody who was admitted.
    void set_policy(const AccessPolicy& policy) { policy_ = policy; }
    /// Sets how certificates are judged. Without it no certificate is trusted.
    void set_trust(Trust trust) { trust_ = std::move(trust); }
    /// Returns the rows before, because to free many takes long.
    std::shared_ptr<const TokenTable> set_tokens(std::shared_ptr<const TokenTable> tokens) {
        return std::exchange(tokens_, std::move(tokens));
    }
    [[nodiscard]] const TokenTable& tokens() const { return *tokens_; }

    /// Identifies a peer. Fails with NOT_ALLOWED and the remedy, or with BUSY if its token is wrong
    /// and several from its address were.
    [[nodiscard]] Reply<Principal> identify(const PeerIdentity& peer, std::string_view token,
                                            Time now, WallClock::time_point wall);

    /// Identifies the sender of an HTTP request by its bearer token, the secret of its cookie, or
    /// its transport. Only refusals are logged.
    [[nodiscard]] Reply<Principal> identify_request(const PeerIdentity& peer,
                                                    std::string_view bearer,
                                                    std::string_view cookie, Time now,
                                                    WallClock::time_point wall);
    /// Returns the question that a browser must answer before a code logs it in: which principal it
    /// is and which it becomes. Empty if it is that one already, for the daemon's own user where
    /// nobody is logged in, and for a code that is not valid.
    [[nodiscard]] std::string question_before(const PeerIdentity& peer, std::string_view code,
                                              std::string_view cookie,
                                              WallClock::time_point wall) const;
    /// Begins a login of the page by a token or, with an empty token, by a code of `raynest open`.
    /// Returns the secret of its cookie.
    [[nodiscard]] Reply<std::string> log_in(const PeerIdentity& peer, std::string_view token,
                                            std::string_view code, Time now,
                                            WallClock::time_point wall);
    [[nodiscard]] PageLogins& logins() { return logins_; }

    /// True if the principal would be admitted again, as the same: its row has not changed, its
    /// certificate is trusted, the policy lets its transport in, its login of the page goes on.
    [[nodiscard]] bool still_valid(const Principal& principal, WallClock::time_point wall) const;
    /// True if a certificate of an admitted peer has expired since the last call: then ask
    /// still_valid().
    [[nodiscard]] bool certificates_ended(WallClock::time_point now);

private:
    /// What is logged: connections that begin and refusals, or refusals alone.
    enum class Audit { logins, refusals };
    /// Returns the error of a wrong token or code: BUSY while wrong ones of the address must wait,
    /// else NOT_ALLOWED with `why`, and then counts it.
    [[nodiscard]] tl::unexpected<protocol::Error> refuse_secret(const PeerIdentity& peer, Time now,
                                                                const char* reason,
                                                                const char* why);
    [[nodiscard]] Reply<Principal> by_token(const PeerIdentity& peer, std::string_view token,
                                            Time now, WallClock::time_point wall, Audit audited);
    [[nodiscard]] Reply<Principal> by_code(const PeerIdentity& peer, std::string_view code,
                                           Time now, WallClock::time_point wall);
    [[nodiscard]] Reply<Principal> by_certificate(const PeerIdentity& peer,
                                                  WallClock::time_point wall, Audit audited);
    [[nodiscard]] Reply<Principal> anonymous(const PeerIdentity& peer) const;
    /// Returns the principal of a certificate; nothing if it is not let in.
    [[nodiscard]] std::optional<Principal> holder_of(
        const std::string& subject, const std::shared_ptr<const ClientCertificate>& certificate,
        WallClock::time_point wall) const;
    /// Logs and counts a refusal.
    void refuse_login(const PeerIdentity& peer, const std::string& principal,
                      const std::string& reason) const;

    AccessPolicy policy_;
    Trust trust_;
    std::shared_ptr<const TokenTable> tokens_ = std::make_shared<TokenTable>();
    std::set<WallClock::time_point> certificate_ends_;  ///< ends of admitted peers' certificates
    LoginFailures failures_;
    PageLogins logins_;
    Metrics::Counter* refused_;
};

/// Identifies the principal of a peer by the name from its transport, without a token. Peers
/// beyond loopback are refused.
[[nodiscard]] Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& hello,
                                            const protocol::Limits& limits);

/// The type of authenticate(), which the daemon and tests replace.
using Authenticator = std::function<Reply<Principal>(const PeerIdentity&, const wire::Hello&,
                                                     const protocol::Limits&)>;

}  // namespace raynest::server
