// Principals own scenes and jobs; quotas and fair shares are counted per principal.
//
//   Transport ──PeerIdentity──┐
//                             ├─► Authentication::identify() ─► Principal {id, quota, role}
//   Hello (its token) ────────┘
//
// The page shows a token, or a code of `raynest open`, once: page_logins.h. Its WebSocket then
// comes with the principal of its cookie.
//
// Until a peer has sent Hello, it counts under the name from its transport.
#pragma once

#include "protocol/limits.h"
#include "server/ground/errors.h"
#include "server/security/role.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

namespace raynest::wire {
struct Hello;
}

namespace raynest::server {

/// The identity of a peer, as known from its transport.
struct PeerIdentity {
    /// On a Unix socket: `own_user` is the daemon's own user or root, `unknown_user` one whom the
    /// system does not name to the daemon (user_namespace.h).
    enum class Place { own_user, other_user, unknown_user, loopback, remote };

    /// The principal of a peer without a token: "uid:1000", "127.0.0.1", or the network of an IPv6
    /// address, "2001:db8:0:1::/64".
    std::string name;
    Place place = Place::loopback;
    std::string transport = "tcp";  ///< tcp, tls, unix, http or https
    std::string subject = {};       ///< subject of a verified client certificate; empty: none
    /// Why a verified certificate names no principal; empty: it does
    std::string subject_fault = {};
    std::shared_ptr<const struct ClientCertificate> certificate = {};  ///< null without a subject
    /// The sender of the HTTP request that became a WebSocket; null: another transport.
    std::shared_ptr<const struct Principal> sender = {};
    std::string address = {};  ///< the whole IPv6 address behind `name`; empty: `name` says all

    /// Returns where the peer is, for the log and for lists.
    [[nodiscard]] const std::string& whereabouts() const {
        return address.empty() ? name : address;
    }
};

/// Quotas that may differ between principals; 0: the limit principal_*_max.
struct Quota {
#define RAYNEST_QUOTA(key, least) std::uint64_t key = 0;
#include "protocol/lists/quotas.def"
    bool operator==(const Quota&) const = default;
};

/// How a peer was admitted. When tokens, certificates or options change, the same rule is asked
/// again (Authentication::still_valid).
struct Admittance {
    enum class By { transport, certificate, token };
    By by = By::transport;
    PeerIdentity::Place place = PeerIdentity::Place::own_user;  ///< used by `transport` alone
    bool is_encrypted = false;                                  ///< used by `transport` alone
    std::shared_ptr<const ClientCertificate> certificate = {};  ///< null unless by `certificate`
};

/// The user that a connection belongs to: a token's name, a certificate's subject, a uid or an
/// address.
struct Principal {
    std::string id;
    Quota quota;
    Role role = Role::user;
    std::string credential = {};   ///< content of the token file's row; empty: there was none
    std::uint64_t page_login = 0;  ///< number of the page's login (page_logins.h); 0: none
    Admittance admittance = {};
};

}  // namespace raynest::server
