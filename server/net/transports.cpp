#include "server/net/transports.h"

#include "server/net/socket_transport.h"
#include "server/net/tls_transport.h"

#include <array>
#include <cstddef>
#include <utility>

namespace raynest::server {
namespace {

std::unique_ptr<Transport> make_plain(Socket socket, const TransportParts& /*parts*/) {
    return std::make_unique<SocketTransport>(std::move(socket));
}

std::unique_ptr<Transport> make_tls(Socket socket, const TransportParts& parts) {
    return std::make_unique<TlsTransport>(std::move(socket), *parts.tls);
}

/// The transport of each row of `schemes`, in its order.
constexpr std::array<MakeTransport, schemes.size()> makers = {make_plain, make_tls, make_plain};
static_assert(makers.back() != nullptr, "each scheme has a transport");

}  // namespace

MakeTransport transport_of(const Scheme& scheme) {
    return makers[static_cast<std::size_t>(&scheme - schemes.data())];
}

}  // namespace raynest::server
