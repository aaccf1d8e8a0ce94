// A set of addresses, given one by one or as networks: 192.0.2.7, 10.0.0.0/8, 2001:db8::/32.
#pragma once

#include "server/net/asio.h"

#include <array>
#include <string>
#include <vector>

namespace raynest::server {

class AddressSet {
public:
    AddressSet() = default;
    /// Holds all of the texts that add() takes.
    explicit AddressSet(const std::vector<std::string>& texts);

    /// Adds ADDRESS or ADDRESS/BITS. Returns what is wrong with the text; empty if nothing is.
    [[nodiscard]] std::string add(const std::string& text);
    /// True for a member. An IPv4 address is the same as the IPv6 address that maps it, and lies in
    /// no wider network of IPv6.
    [[nodiscard]] bool contains(const asio::ip::address& address) const;

private:
    /// IPv4 networks are kept as those of IPv6 that map them.
    struct Network {
        using Bytes = std::array<unsigned char, 16>;
        Bytes bytes{};
        unsigned bits = 0;  ///< leading bits of a member that are those of `bytes`

        [[nodiscard]] bool contains(const Bytes& address) const;
    };
    std::vector<Network> networks_;
};

}  // namespace raynest::server
