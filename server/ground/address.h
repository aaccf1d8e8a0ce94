// Addresses to listen on, tcp://HOST:PORT, tls://HOST:PORT, unix:PATH, fd:N, or HOST:PORT and
// https://HOST:PORT for the page, checked before a socket is made.
#pragma once

#include "engine/result.h"

#include <array>
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
    int descriptor = -1;    ///< an inherited socket that listens there; -1: none, make one
    bool has_file = false;  ///< the file of that socket is to be removed at the end
};
using Address = std::variant<TcpAddress, UnixAddress>;

/// Mode and group of a Unix socket's file; they decide which users may connect.
struct SocketAccess {
    unsigned mode = 0600;
    std::optional<unsigned> group;  ///< group id; empty: the daemon's own group
};

/// A scheme of --listen.
struct Scheme {
    enum class Place { host_and_port, path };

    std::string_view name;  ///< the part of an address before the first ':'
    Place place;            ///< the form of the part after it
    bool encrypted;
};

/// THE LIST of schemes. net/transports.cpp has the transport of each.
inline constexpr std::array schemes = {
    Scheme{"tcp", Scheme::Place::host_and_port, false},
    Scheme{"tls", Scheme::Place::host_and_port, true},
    Scheme{"unix", Scheme::Place::path, false},
};

/// Returns null for a scheme that is not in the list.
[[nodiscard]] const Scheme* find_scheme(std::string_view name);

/// Parses a URI; "localhost" means 127.0.0.1. fd:N and tls://fd:N are the address of that
/// descriptor, which must be a listening socket. An address beyond loopback needs more, see
/// listen_policy.h.
[[nodiscard]] Result<Address> parse_address(std::string_view uri);

/// Returns the address of a listening socket; nothing if the descriptor is none.
[[nodiscard]] std::optional<Address> address_of(int descriptor);

/// Parses HOST:PORT or http://HOST:PORT, or https://HOST:PORT, whose connections are encrypted.
[[nodiscard]] Result<Address> parse_http_address(std::string_view text);

/// True if other machines may reach the address.
[[nodiscard]] bool is_beyond_loopback(const Address& address);

/// True for the name of a peer on another machine that is known by its address alone: an IPv4 address
/// or an IPv6 network (PeerIdentity::name), beyond loopback.
[[nodiscard]] bool is_remote_peer(const std::string& name);

/// Returns the name of the address's scheme, or http or https.
[[nodiscard]] std::string scheme_of(const Address& address);

/// Returns a URI that parse_address() reads, e.g. "tcp://[::1]:31060".
[[nodiscard]] std::string to_uri(const Address& address);

/// The parts of "name", "name:port", "[v6]" or "[v6]:port", as a Host header has them.
struct HostAndPort {
    std::string_view name;
    std::string_view port;  ///< empty: none
};

[[nodiscard]] HostAndPort split_host(std::string_view host);

/// True for what --http-host takes: a host name or address, perhaps with a port.
[[nodiscard]] bool is_http_host(std::string_view text);

/// Says how another machine sees a page that listens on loopback. The page answers to its own port
/// alone, so that both ends of the tunnel have it.
[[nodiscard]] std::string forward_hint(const std::string& uri);

}  // namespace raynest::server
