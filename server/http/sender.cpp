#include "server/http/sender.h"

#include "server/net/socket_transport.h"

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

using Place = PeerIdentity::Place;

std::string_view trimmed(std::string_view text) {
    constexpr std::string_view blanks = " \t";
    const std::size_t first = text.find_first_not_of(blanks);
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(blanks) - first + 1);
}

/// Returns the items of a list that may be spread over several headers.
std::vector<std::string_view> items(const std::vector<std::string_view>& headers) {
    std::vector<std::string_view> found;
    for (std::string_view left : headers)
        for (std::size_t comma = 0; comma != std::string_view::npos;) {
            comma = left.find(',');
            found.push_back(trimmed(left.substr(0, comma)));
            if (comma != std::string_view::npos) left.remove_prefix(comma + 1);
        }
    return found;
}

/// Reads an address, perhaps in brackets and with a port, as proxies write it.
std::optional<asio::ip::address> to_address(std::string_view text) {
    if (text.starts_with('['))
        text = text.substr(1, text.find(']') - 1);
    else if (std::ranges::count(text, ':') == 1)
        text = text.substr(0, text.find(':'));
    SystemError error;
    const auto address = asio::ip::make_address(std::string(text), error);
    return error ? std::nullopt : std::optional(address);
}

bool is_loopback_host(std::string_view host) {
    if (lower(host.substr(0, host.find(':'))) == "localhost") return true;
    const auto address = to_address(host);
    return address && address->is_loopback();
}

/// Takes the host of http://HOST/PATH, which counts in place of the Host header (RFC 9112, 3.2.2).
void take_absolute_target(HttpRequest& request) {
    std::string_view rest = request.target;
    const std::size_t slashes = rest.find("://");
    if (slashes == std::string_view::npos) return;
    const std::string scheme = lower(rest.substr(0, slashes));
    if (scheme != "http" && scheme != "https") return;
    rest.remove_prefix(slashes + 3);
    const std::string_view host = rest.substr(0, rest.find_first_of("/?#"));
    rest.remove_prefix(host.size());
    request.target = rest.starts_with('/') ? rest : "/";
    // A request with several Host headers, or with none where it needs one, is refused all the
    // same.
    if (request.hosts.size() == 1 || request.may_lack_host()) request.hosts = {host};
}

/// Returns the address of the last hop that is no trusted proxy, or else of the first one. Without
/// any, and if one is unreadable: nothing.
std::optional<asio::ip::address> sender_of(const ForwardedHeaders& forwarded,
                                           const AddressSet& proxies) {
    const auto hops = items(forwarded.sender);
    std::optional<asio::ip::address> sender;
    for (auto hop = hops.rbegin(); hop != hops.rend(); ++hop) {
        sender = to_address(*hop);
        if (!sender || !proxies.contains(*sender)) break;
    }
    return sender;
}

void believe(const ForwardedHeaders& forwarded, HttpRequest& request, const AddressSet& proxies) {
    if (const auto sender = sender_of(forwarded, proxies)) {
        PeerIdentity peer = identity_of(*sender);
        request.sender.name = std::move(peer.name);
        request.sender.address = std::move(peer.address);
    }
    // Each proxy appends to a list, so the last item is of the nearest one.
    if (const auto schemes = items(forwarded.scheme); !schemes.empty())
        request.is_encrypted = lower(schemes.back()) == "https" || lower(schemes.back()) == "wss";
    if (const auto hosts = items(forwarded.host); !hosts.empty() && request.hosts.size() == 1)
        request.hosts = {hosts.back()};
    // It is the certificate of the proxy, for which the sender does not stand.
    request.sender.subject.clear();
    request.sender.subject_fault.clear();
    request.sender.certificate.reset();
}

}  // namespace

bool is_from_proxies(std::string_view header) {
    // Each service has its own name for the same thing, so most are known by a part of it.
    constexpr std::array<std::string_view, 15> parts = {
        "forward",        "proxy",       "via",      "surrogate",   "client-ip",
        "clientip",       "remote-addr", "cdn-loop", "x-original-", "x-envoy-",
        "viewer-address", "user-ip",     "x-arr-",   "x-varnish",   "x-amzn-trace-id"};
    std::string name = lower(header);
    // Some proxies pass names on with underscores.
    std::ranges::replace(name, '_', '-');
    return name.ends_with("-ip") || std::ranges::any_of(parts, [&](std::string_view part) {
               return name.find(part) != std::string::npos;
           });
}

void find_sender(HttpRequest& request, const asio::ip::address& peer, const AddressSet& proxies) {
    // A proxy may pass an absolute target on: then both its host and the header must be loopback.
    const bool is_header_loopback = std::ranges::all_of(request.hosts, is_loopback_host);
    take_absolute_target(request);
    const bool is_direct = !request.forwarded.any;
    const std::string_view host = request.hosts.size() == 1 ? request.hosts.front() : "";
    const bool is_local = request.sender.place == Place::loopback && is_direct &&
                          is_header_loopback && is_loopback_host(host);
    if (!is_local) request.sender.place = Place::remote;
    if (!is_direct && proxies.contains(peer)) believe(request.forwarded, request, proxies);
}

}  // namespace raynest::server
