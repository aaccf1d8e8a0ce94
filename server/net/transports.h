// The transport of each scheme of --listen.
#pragma once

#include "server/ground/address.h"
#include "server/net/transport.h"
#include "server/security/tls_context.h"

#include <memory>

namespace raynest::server {

/// Settings that transports share. A reload replaces `tls`; open connections keep theirs.
struct TransportParts {
    std::shared_ptr<const TlsContext> tls;  ///< null: no listener needs it
};

using MakeTransport = std::unique_ptr<Transport> (*)(Socket socket, const TransportParts& parts);

/// Returns what makes the transport of a connection; `scheme` is one of `schemes`.
[[nodiscard]] MakeTransport transport_of(const Scheme& scheme);

}  // namespace raynest::server
