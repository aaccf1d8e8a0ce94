// Where the daemon listens: tcp://HOST:PORT or unix:PATH, checked before a socket is made.
#pragma once

#include "engine/result.h"

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

namespace raynest::server {

struct TcpAddress {
    std::string host;  ///< numeric IPv4 or IPv6, no brackets
    std::uint16_t port = 0;
    std::string scheme = "tcp";
};
struct UnixAddress {
    std::string path;
};
using Address = std::variant<TcpAddress, UnixAddress>;

/// Who may connect to a Unix socket: the mode and the group of its file.
struct SocketAccess {
    unsigned mode = 0600;
    std::optional<unsigned> group;  ///< number of a group; none: the daemon's own
};

/// "localhost" means 127.0.0.1. Addresses other than loopback are refused: until there is a token,
/// whoever can connect may do everything.
[[nodiscard]] Result<Address> parse_address(std::string_view uri);

/// A name in the list of transports (net/transports.h): "tcp", "unix".
[[nodiscard]] std::string scheme_of(const Address& address);

/// The URI that parse_address reads, e.g. "tcp://[::1]:31060".
[[nodiscard]] std::string to_uri(const Address& address);

}  // namespace raynest::server
