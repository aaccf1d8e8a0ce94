#include "server/net/address_set.h"

#include <algorithm>
#include <charconv>
#include <string_view>

namespace raynest::server {
namespace {

std::array<unsigned char, 16> to_bytes(const asio::ip::address& address) {
    return (address.is_v4() ? asio::ip::make_address_v6(asio::ip::v4_mapped, address.to_v4())
                            : address.to_v6())
        .to_bytes();
}

/// IPv4 within IPv6: ::ffff:0:0/96.
constexpr std::array<unsigned char, 16> v4_first{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xFF, 0xFF};
constexpr unsigned v4_bits = 96;

}  // namespace

bool AddressSet::Network::contains(const Bytes& address) const {
    const unsigned whole = bits / 8;
    const unsigned rest = bits % 8;
    return std::equal(address.begin(), address.begin() + whole, bytes.begin()) &&
           (rest == 0 || ((address[whole] ^ bytes[whole]) >> (8 - rest)) == 0);
}

AddressSet::AddressSet(const std::vector<std::string>& texts) {
    for (const std::string& text : texts) (void)add(text);
}

std::string AddressSet::add(const std::string& text) {
    const std::size_t slash = text.find('/');
    SystemError error;
    const auto address = asio::ip::make_address(text.substr(0, slash), error);
    const unsigned bits_max = error || address.is_v6() ? 128 : 32;
    unsigned bits = bits_max;
    bool is_good = !error;
    if (slash != std::string::npos) {
        const std::string_view number = std::string_view(text).substr(slash + 1);
        const auto [end, fault] =
            std::from_chars(number.data(), number.data() + number.size(), bits);
        is_good = is_good && fault == std::errc{} && end == number.data() + number.size() &&
                  bits <= bits_max;
    }
    if (!is_good)
        return "'" + text +
               "' is not an address; write one such as 127.0.0.1, or a network such as "
               "10.0.0.0/8";
    const Network network{to_bytes(address), bits + (128 - bits_max)};
    const bool is_of_v4 = network.bits == v4_bits && network.contains(v4_first);
    if (network.bits == 0 || is_of_v4)
        return "'" + text + "' is every address; name those that are meant";
    for (unsigned bit = network.bits; bit < 128; ++bit)
        if ((network.bytes[bit / 8] >> (7 - bit % 8) & 1) != 0)
            return "'" + text + "' is an address within a network; write " + text.substr(0, slash) +
                   " for the address alone, or the network's first address";
    networks_.push_back(network);
    return "";
}

bool AddressSet::contains(const asio::ip::address& address) const {
    const auto bytes = to_bytes(address);
    const bool is_v4 = Network{v4_first, v4_bits}.contains(bytes);
    return std::ranges::any_of(networks_, [&](const Network& network) {
        return network.contains(bytes) && (!is_v4 || network.bits >= v4_bits);
    });
}

}  // namespace raynest::server
