// Addresses of daemons, as users write them: which entry of hosts.toml is theirs, and who can read
// along.
#pragma once

#include <sys/socket.h>

#include <optional>
#include <string>

namespace raynest::client {

struct Authority {
    std::string host;  ///< an IPv6 address is without its brackets
    std::string port;
};

/// Splits tcp://HOST:PORT or tls://HOST:PORT; none where a part is missing or is no name, address
/// or port from 1 to 65535.
[[nodiscard]] std::optional<Authority> authority_of(const std::string& uri);

/// Returns the address with scheme, host and port in small letters: names are compared without
/// case. The user of ssh:// and paths keep theirs.
[[nodiscard]] std::string comparable(std::string uri);

/// True for an address, not a name, of this machine's loopback: 127.0.0.0/8, ::1, and the former
/// mapped into IPv6.
[[nodiscard]] bool is_loopback(const std::string& host);
[[nodiscard]] bool is_loopback(const sockaddr& address);

/// True for a server of this machine, by its words: unix:PATH, or `localhost` or a loopback
/// address.
[[nodiscard]] bool is_this_machine(const std::string& uri);

}  // namespace raynest::client
