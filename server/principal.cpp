#include "server/principal.h"

#include "protocol/wire.h"

namespace raynest::server {

Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& /*hello*/,
                              const protocol::Limits& limits) {
    return Principal{peer.name, {limits.principal_connections_max}};
}

}  // namespace raynest::server
