#include "server/net/transports.h"

#include "server/net/socket_transport.h"

#include <algorithm>
#include <array>
#include <utility>

namespace raynest::server {
namespace {

template <class Made>
std::unique_ptr<Transport> make(Socket socket) {
    return std::make_unique<Made>(std::move(socket));
}

/// THE LIST of transports.
constexpr std::array schemes = {
    Scheme{"tcp", Scheme::Place::host_and_port, make<SocketTransport>},
    Scheme{"unix", Scheme::Place::path, make<SocketTransport>},
};

}  // namespace

const Scheme* find_scheme(std::string_view name) {
    const auto found = std::find_if(schemes.begin(), schemes.end(),
                                    [&](const Scheme& scheme) { return scheme.name == name; });
    return found == schemes.end() ? nullptr : &*found;
}

}  // namespace raynest::server
