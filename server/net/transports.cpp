#include "server/net/transports.h"

#include "server/net/socket_transport.h"
#include "server/net/tls_transport.h"

#include <algorithm>
#include <array>
#include <utility>

namespace raynest::server {
namespace {

std::unique_ptr<Transport> make_plain(Socket socket, const TransportParts& /*parts*/) {
    return std::make_unique<SocketTransport>(std::move(socket));
}

std::unique_ptr<Transport> make_tls(Socket socket, const TransportParts& parts) {
    return std::make_unique<TlsTransport>(std::move(socket), *parts.tls);
}

/// THE LIST of transports.
constexpr std::array schemes = {
    Scheme{"tcp", Scheme::Place::host_and_port, false, make_plain},
    Scheme{"tls", Scheme::Place::host_and_port, true, make_tls},
    Scheme{"unix", Scheme::Place::path, false, make_plain},
};

}  // namespace

const Scheme* find_scheme(std::string_view name) {
    const auto found = std::find_if(schemes.begin(), schemes.end(),
                                    [&](const Scheme& scheme) { return scheme.name == name; });
    return found == schemes.end() ? nullptr : &*found;
}

}  // namespace raynest::server
