#include "client/net/address.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <cstring>
#include <string_view>

namespace raynest::client {
namespace {

constexpr std::string_view host_letters =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_.";

bool is_port(const std::string& text) {
    std::uint16_t port = 0;
    const char* end = text.data() + text.size();
    const auto read = std::from_chars(text.data(), end, port);
    return read.ec == std::errc{} && read.ptr == end && port != 0;
}

char small(char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c + ('a' - 'A')) : c;
}

bool is_loopback(const in_addr& address) {
    return ntohl(address.s_addr) >> 24 == 127;
}

bool is_loopback(const in6_addr& address) {
    in_addr mapped{};
    std::memcpy(&mapped, address.s6_addr + 12, sizeof mapped);
    const bool is_mapped = IN6_IS_ADDR_V4MAPPED(&address);
    return IN6_IS_ADDR_LOOPBACK(&address) || (is_mapped && is_loopback(mapped));
}

}  // namespace

std::optional<Authority> authority_of(const std::string& uri) {
    const std::string authority = uri.substr(6);
    const std::size_t colon = authority.rfind(':');
    if (colon == std::string::npos || !is_port(authority.substr(colon + 1))) return std::nullopt;
    std::string host = authority.substr(0, colon);
    const bool bracketed = host.size() > 2 && host.front() == '[' && host.back() == ']';
    if (bracketed) host = host.substr(1, host.size() - 2);
    const std::string letters = std::string(host_letters) + (bracketed ? ":%" : "");
    if (host.empty() || host.find_first_not_of(letters) != std::string::npos) return std::nullopt;
    return Authority{host, authority.substr(colon + 1)};
}

std::string comparable(std::string uri) {
    const auto at = [&](std::size_t i) {
        return uri.begin() + static_cast<std::ptrdiff_t>(std::min(i, uri.size()));
    };
    const auto lower = [](auto first, auto last) { std::transform(first, last, first, small); };
    const std::size_t colon = uri.find(':');
    lower(uri.begin(), at(colon));
    if (colon == std::string::npos || uri.compare(colon, 3, "://") != 0) return uri;
    const std::size_t end = uri.find('/', colon + 3);
    const std::size_t user = uri.substr(0, end).rfind('@');
    lower(at(user == std::string::npos ? colon + 3 : user + 1), at(end));
    return uri;
}

bool is_loopback(const std::string& host) {
    in_addr four{};
    in6_addr six{};
    return (::inet_pton(AF_INET, host.c_str(), &four) == 1 && is_loopback(four)) ||
           (::inet_pton(AF_INET6, host.c_str(), &six) == 1 && is_loopback(six));
}

bool is_loopback(const sockaddr& address) {
    if (address.sa_family == AF_INET) {
        sockaddr_in four{};
        std::memcpy(&four, &address, sizeof four);
        return is_loopback(four.sin_addr);
    }
    sockaddr_in6 six{};
    if (address.sa_family == AF_INET6) std::memcpy(&six, &address, sizeof six);
    return is_loopback(six.sin6_addr);
}

bool is_this_machine(const std::string& uri) {
    if (uri.starts_with("unix:")) return true;
    if (!uri.starts_with("tcp://") && !uri.starts_with("tls://")) return false;
    const auto authority = authority_of(uri);
    return authority && (comparable("tcp://" + authority->host) == "tcp://localhost" ||
                         is_loopback(authority->host));
}

}  // namespace raynest::client
