// THE LIST of transports: what carries frames over the sockets of each scheme of --listen.
#pragma once

#include "server/net/transport.h"

#include <memory>
#include <string_view>

namespace raynest::server {

using MakeTransport = std::unique_ptr<Transport> (*)(Socket socket);

struct Scheme {
    enum class Place { host_and_port, path };

    std::string_view name;  ///< what stands before ':' in the address
    Place place;            ///< what stands after it
    MakeTransport make;
};

/// null for a scheme that is not in the list.
[[nodiscard]] const Scheme* find_scheme(std::string_view name);

}  // namespace raynest::server
