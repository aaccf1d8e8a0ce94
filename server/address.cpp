#include "server/address.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/un.h>

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

Result<Address> parse_tcp(std::string_view uri, std::string_view rest) {
    constexpr std::string_view malformed =
        "is not an address; write tcp://HOST:PORT, e.g. tcp://127.0.0.1:31060";
    const auto colon = rest.rfind(':');
    if (colon == std::string_view::npos) return refused(uri, malformed);
    std::string_view host = rest.substr(0, colon);
    const std::string_view port_text = rest.substr(colon + 1);
    if (host.size() > 2 && host.front() == '[' && host.back() == ']')
        host = host.substr(1, host.size() - 2);

    TcpAddress address{host == "localhost" ? "127.0.0.1" : std::string(host), 0};
    const auto [end, error] =
        std::from_chars(port_text.data(), port_text.data() + port_text.size(), address.port);
    if (error != std::errc{} || end != port_text.data() + port_text.size())
        return refused(uri, malformed);
    if (!is_numeric(address.host)) return refused(uri, malformed);
    if (!is_loopback(address.host))
        return refused(uri,
                       "is not loopback, and without a token whoever can connect may do "
                       "everything; listen on 127.0.0.1, [::1] or unix:PATH and forward the port, "
                       "e.g. by ssh -L");
    return Address{address};
}

}  // namespace

Result<Address> parse_address(std::string_view uri) {
    constexpr std::string_view tcp = "tcp://";
    constexpr std::string_view unix_scheme = "unix:";
    if (uri.substr(0, tcp.size()) == tcp) return parse_tcp(uri, uri.substr(tcp.size()));
    if (uri.substr(0, unix_scheme.size()) == unix_scheme) {
        std::string path(uri.substr(unix_scheme.size()));
        if (path.empty() || path.size() >= sizeof(sockaddr_un::sun_path) ||
            path.find('\0') != std::string::npos)
            return refused(uri, "is not a socket path of 1.." +
                                    std::to_string(sizeof(sockaddr_un::sun_path) - 1) + " bytes");
        return Address{UnixAddress{std::move(path)}};
    }
    return refused(uri, "is not an address; write tcp://HOST:PORT or unix:PATH");
}

std::string to_uri(const Address& address) {
    if (const auto* tcp = std::get_if<TcpAddress>(&address)) {
        const bool v6 = tcp->host.find(':') != std::string::npos;
        return "tcp://" + (v6 ? "[" + tcp->host + "]" : tcp->host) + ":" +
               std::to_string(tcp->port);
    }
    return "unix:" + std::get<UnixAddress>(address).path;
}

}  // namespace raynest::server
