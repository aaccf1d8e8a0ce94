#include "server/ground/address.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <charconv>
#include <utility>

namespace raynest::server {
namespace {

tl::unexpected<Error> refused(std::string_view uri, std::string_view why) {
    std::string message = "'";
    message.append(uri).append("' ").append(why);
    return fail(ErrorCode::param_invalid, std::move(message));
}

bool is_loopback(const std::string& host) {
    in_addr v4{};
    if (inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == 127;
    in6_addr v6{};
    return inet_pton(AF_INET6, host.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

bool is_numeric(const std::string& host) {
    in6_addr storage{};
    return inet_pton(AF_INET, host.c_str(), &storage) == 1 ||
           inet_pton(AF_INET6, host.c_str(), &storage) == 1;
}

std::optional<int> to_descriptor(std::string_view text) {
    int number = -1;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    const bool is_number = error == std::errc{} && end == text.data() + text.size();
    return is_number && number >= 0 ? std::optional(number) : std::nullopt;
}

/// Reads the address of descriptor N, the part `text` of fd:N or tls://fd:N.
Result<Address> parse_descriptor(std::string_view uri, std::string_view scheme,
                                 std::string_view text) {
    const auto number = to_descriptor(text);
    auto address = number ? address_of(*number) : std::nullopt;
    if (!address)
        return refused(uri, "is no listening socket; pass one to the daemon under that number");
    auto* tcp = std::get_if<TcpAddress>(&*address);
    if (scheme != "fd" && tcp == nullptr) return refused(uri, "is a Unix socket; write fd:N");
    if (tcp != nullptr && scheme != "fd") tcp->scheme = scheme;
    return std::move(*address);
}

constexpr std::string_view malformed_tcp =
    "is not an address; write tcp://HOST:PORT, e.g. tcp://127.0.0.1:31060";
constexpr std::string_view malformed_http =
    "is not an address; write HOST:PORT, e.g. 127.0.0.1:31061, https://HOST:PORT, or off";
/// Parses HOST:PORT, the part `rest` of `uri`.
Result<Address> parse_tcp(std::string_view uri, std::string_view scheme, std::string_view rest,
                          std::string_view malformed) {
    const auto colon = rest.rfind(':');
    if (colon == std::string_view::npos) return refused(uri, malformed);
    std::string_view host = rest.substr(0, colon);
    const std::string_view port_text = rest.substr(colon + 1);
    if (host.size() > 2 && host.front() == '[' && host.back() == ']')
        host = host.substr(1, host.size() - 2);

    TcpAddress address{host == "localhost" ? "127.0.0.1" : std::string(host), 0,
                       std::string(scheme)};
    const auto [end, error] =
        std::from_chars(port_text.data(), port_text.data() + port_text.size(), address.port);
    if (error != std::errc{} || end != port_text.data() + port_text.size())
        return refused(uri, malformed);
    if (!is_numeric(address.host))
        return refused(uri, "names a host; an IP address or localhost is needed");
    return Address{address};
}

Result<Address> parse_path(std::string_view uri, std::string_view rest) {
    if (rest.empty() || rest.size() >= sizeof(sockaddr_un::sun_path) ||
        rest.find('\0') != std::string_view::npos)
        return refused(uri, "is not a socket path of 1.." +
                                std::to_string(sizeof(sockaddr_un::sun_path) - 1) + " bytes");
    return Address{UnixAddress{std::string(rest)}};
}

}  // namespace

const Scheme* find_scheme(std::string_view name) {
    const auto* found = std::ranges::find(schemes, name, &Scheme::name);
    return found == schemes.end() ? nullptr : found;
}

std::optional<Address> address_of(int descriptor) {
    int listens = 0;
    socklen_t size = sizeof listens;
    if (getsockopt(descriptor, SOL_SOCKET, SO_ACCEPTCONN, &listens, &size) != 0 || listens == 0)
        return std::nullopt;
    sockaddr_storage name{};
    size = sizeof name;
    if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&name), &size) != 0)
        return std::nullopt;
    if (name.ss_family == AF_UNIX) {
        const auto* local = reinterpret_cast<const sockaddr_un*>(&name);
        return UnixAddress{static_cast<const char*>(local->sun_path), descriptor};
    }
    std::array<char, INET6_ADDRSTRLEN> host{};
    const auto* v4 = reinterpret_cast<const sockaddr_in*>(&name);
    const auto* v6 = reinterpret_cast<const sockaddr_in6*>(&name);
    const bool is_v4 = name.ss_family == AF_INET;
    const void* number = is_v4 ? static_cast<const void*>(&v4->sin_addr) : &v6->sin6_addr;
    if ((!is_v4 && name.ss_family != AF_INET6) ||
        inet_ntop(name.ss_family, number, host.data(), host.size()) == nullptr)
        return std::nullopt;
    return TcpAddress{host.data(), ntohs(is_v4 ? v4->sin_port : v6->sin6_port), "tcp", descriptor};
}

Result<Address> parse_address(std::string_view uri) {
    if (uri.starts_with("fd:")) return parse_descriptor(uri, "fd", uri.substr(3));
    if (uri.starts_with("tls://fd:")) return parse_descriptor(uri, "tls", uri.substr(9));
    const std::string_view name = uri.substr(0, uri.find(':'));
    const Scheme* scheme = name.size() == uri.size() ? nullptr : find_scheme(name);
    std::string_view rest = uri.substr(std::min(uri.size(), name.size() + 1));
    if (scheme != nullptr && scheme->place == Scheme::Place::path) return parse_path(uri, rest);
    if (scheme != nullptr && rest.substr(0, 2) == "//")
        return parse_tcp(uri, name, rest.substr(2), malformed_tcp);
    return refused(uri,
                   "is not an address; write tcp://HOST:PORT, tls://HOST:PORT, unix:PATH or fd:N");
}

Result<Address> parse_http_address(std::string_view text) {
    for (const std::string_view scheme : {"https", "http"})
        if (text.starts_with(scheme) && text.substr(scheme.size()).starts_with("://"))
            return parse_tcp(text, scheme, text.substr(scheme.size() + 3), malformed_http);
    if (text.find("://") != std::string_view::npos) return refused(text, malformed_http);
    return parse_tcp(text, "http", text, malformed_http);
}

bool is_beyond_loopback(const Address& address) {
    const auto* tcp = std::get_if<TcpAddress>(&address);
    return tcp != nullptr && !is_loopback(tcp->host);
}

bool is_remote_peer(const std::string& name) {
    const std::string host = name.substr(0, name.find('/'));
    return is_numeric(host) && !is_loopback(host);
}

std::string scheme_of(const Address& address) {
    const auto* tcp = std::get_if<TcpAddress>(&address);
    return tcp != nullptr ? tcp->scheme : "unix";
}

std::string to_uri(const Address& address) {
    if (const auto* tcp = std::get_if<TcpAddress>(&address)) {
        const bool v6 = tcp->host.find(':') != std::string::npos;
        return tcp->scheme + "://" + (v6 ? "[" + tcp->host + "]" : tcp->host) + ":" +
               std::to_string(tcp->port);
    }
    return "unix:" + std::get<UnixAddress>(address).path;
}

HostAndPort split_host(std::string_view host) {
    const std::size_t bracket = host.rfind(']');
    const std::size_t colon = host.rfind(':');
    if (colon == std::string_view::npos || (bracket != std::string_view::npos && colon < bracket))
        return {host, {}};
    return {host.substr(0, colon), host.substr(colon + 1)};
}

bool is_http_host(std::string_view text) {
    constexpr std::size_t bytes_max = 255;
    const auto [name, port] = split_host(text);
    const auto is_plain = [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
               c == '.' || c == '-' || c == ':' || c == '[' || c == ']';
    };
    std::uint16_t number = 0;
    const char* last = port.data() + port.size();
    const auto [end, error] = std::from_chars(port.data(), last, number);
    const bool port_is_good = name.size() == text.size() || (error == std::errc{} && end == last);
    return !name.empty() && text.size() <= bytes_max && port_is_good &&
           std::ranges::all_of(name, is_plain);
}

std::string forward_hint(const std::string& uri) {
    const std::string place = uri.substr(uri.find("//") + 2);
    const std::string port = place.substr(place.rfind(':') + 1);
    return "from another machine: ssh -L " + port + ":" + place + " HOST, then open " +
           uri.substr(0, uri.find("//") + 2) + "localhost:" + port;
}

}  // namespace raynest::server
