#include "server/principal.h"

#include "protocol/wire.h"
#include "server/access.h"
#include "server/log.h"
#include "server/security/authentication.h"

namespace raynest::server {

Reply<Principal> identify(Authentication& authentication, const PeerIdentity& peer,
                          const wire::Hello& hello) {
    auto principal = authentication.identify(peer, protocol::text(hello.token()),
                                             Authentication::Time::clock::now(), WallClock::now());
    if (!principal) return principal;
    const auto is_somebody = access::be_somebody(peer, *principal);
    if (is_somebody) return principal;
    log(LogLevel::info, "login_refused",
        {{"peer", peer.name}, {"transport", peer.transport}, {"reason", "unknown user"}});
    return tl::unexpected(is_somebody.error());
}

Reply<Principal> authenticate(const PeerIdentity& peer, const wire::Hello& /*hello*/,
                              const protocol::Limits& /*limits*/) {
    Authentication without_tokens;
    return without_tokens.identify(peer, "", {}, {});
}

}  // namespace raynest::server
