// Principals: whom quotas and fair shares are counted by, and whom scenes and jobs belong to.
//
//   Transport ──PeerIdentity──┐
//                             ├─► authenticate() ─► Principal {id, quota}
//   Hello (its token) ────────┘
//
// A peer that has not said Hello yet counts under the name that its transport knows it by.
#pragma once

#include "protocol/limits.h"
#include "server/errors.h"

#include <cstdint>
#include <string>

namespace raynest::wire {
struct Hello;
}

namespace raynest::server {

/// A peer as its transport knows it.
struct PeerIdentity {
    std::string name;  ///< "uid:1000", "127.0.0.1"
};

/// What one principal may have at a time. The quotas of jobs, scenes and results are the same for
/// all, the principal_* limits, and are counted by id where they are tested.
struct Quota {
    std::uint64_t connections = 0;
};

struct Principal {
    std::string id;
    Quota quota;
};

/// Decides who the peer is, here and nowhere else: it is whom its transport says. Hello's token is
/// reserved, this daemon knows none.
[[nodiscard]] Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& hello,
                                            const protocol::Limits& limits);

/// Tests put another in its place.
using Authenticator = Reply<Principal> (*)(const PeerIdentity&, const wire::Hello&,
                                           const protocol::Limits&);

}  // namespace raynest::server
