// Addresses to listen on, tcp://HOST:PORT, tls://HOST:PORT, unix:PATH, fd:N, or HOST:PORT and
// https://HOST:PORT for the page, checked before a socket is made.
#pragma once

#include "engine/result.h"

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

namespace raynest::server {

struct TcpAddress {
    std::string host;  ///< numeric IPv4 or IPv6, without brackets
    std::uint16_t port = 0;
    std::string scheme = "tcp";
    int descriptor = -1;  ///< an inherited socket that listens there; -1: none, make one
};
struct UnixAddress {
    std::string path;
    int descriptor = -1;  ///< an inherited socket that listens there; -1: none, make one
};
using Address = std::variant<TcpAddress, UnixAddress>;

/// Mode and group of a Unix socket's file; they decide which users may connect.
struct SocketAccess {
    unsigned mode = 0600;
    std::optional<unsigned> group;  ///< group id; empty: the daemon's own group
};

/// Parses a URI; "localhost" means 127.0.0.1. fd:N and tls://fd:N are the address of that descriptor,
/// which must be a listening socket. An address beyond loopback needs more, see listen_policy.h.
[[nodiscard]] Result<Address> parse_address(std::string_view uri);

/// Returns the address of a listening socket; nothing if the descriptor is none.
[[nodiscard]] std::optional<Address> address_of(int descriptor);

/// Parses HOST:PORT or http://HOST:PORT, or https://HOST:PORT, whose connections are encrypted.
[[nodiscard]] Result<Address> parse_http_address(std::string_view text);

/// True if other machines may reach the address.
[[nodiscard]] bool is_beyond_loopback(const Address& address);

/// Returns the address's name in the list of transports (net/transports.h), or http or https.
[[nodiscard]] std::string scheme_of(const Address& address);

/// Returns a URI that parse_address() reads, e.g. "tcp://[::1]:31060".
[[nodiscard]] std::string to_uri(const Address& address);

}  // namespace raynest::server
