// Principals own scenes and jobs; quotas and fair shares are counted per principal.
//
//   Transport ──PeerIdentity──┐
//                             ├─► authenticate() ─► Principal {id, quota}
//   Hello (its token) ────────┘
//
// Until a peer has sent Hello, it counts under the name from its transport.
#pragma once

#include "protocol/limits.h"
#include "server/errors.h"

#include <cstdint>
#include <string>

namespace raynest::wire {
struct Hello;
}

namespace raynest::server {

/// The identity of a peer, as known from its transport.
struct PeerIdentity {
    std::string name;  ///< "uid:1000", "127.0.0.1"
};

/// Quotas that may differ between principals. The quotas of jobs, scenes and results are the same
/// for all: the principal_* limits.
struct Quota {
    std::uint64_t connections = 0;
};

/// The user that a connection belongs to: a uid or an address.
struct Principal {
    std::string id;
    Quota quota;
};

/// Identifies the principal of a peer by the name from its transport. Ignores Hello's token, which
/// is reserved.
[[nodiscard]] Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& hello,
                                            const protocol::Limits& limits);

/// The type of authenticate(), which tests replace.
using Authenticator = Reply<Principal> (*)(const PeerIdentity&, const wire::Hello&,
                                           const protocol::Limits&);

}  // namespace raynest::server
