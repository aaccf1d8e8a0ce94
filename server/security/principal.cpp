#include "server/security/principal.h"

#include "protocol/wire.h"
#include "server/security/authentication.h"

namespace raynest::server {

Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& /*hello*/,
                              const protocol::Limits& /*limits*/) {
    Authentication without_tokens;
    return without_tokens.identify(peer, "", {}, {});
}

}  // namespace raynest::server
