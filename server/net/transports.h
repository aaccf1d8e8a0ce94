// The list of transports, by the scheme of a --listen address.
#pragma once

#include "server/net/transport.h"
#include "server/security/tls_context.h"

#include <memory>
#include <string_view>

namespace raynest::server {

/// Settings that transports share. A reload replaces `tls`; open connections keep theirs.
struct TransportParts {
    std::shared_ptr<const TlsContext> tls;  ///< null: no listener needs it
};

using MakeTransport = std::unique_ptr<Transport> (*)(Socket socket, const TransportParts& parts);

/// A scheme of --listen, and the transport of its connections.
struct Scheme {
    enum class Place { host_and_port, path };

    std::string_view name;  ///< the part of an address before the first ':'
    Place place;            ///< the form of the part after it
    bool encrypted;         ///< needs TransportParts::tls
    MakeTransport make;
};

/// Returns null for a scheme that is not in the list.
[[nodiscard]] const Scheme* find_scheme(std::string_view name);

}  // namespace raynest::server
