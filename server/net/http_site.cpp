#include "server/net/http_site.h"

#include "protocol/hash.h"
#include "protocol/text.h"
#include "server/embedded.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

/// Media type of Prometheus' text format.
constexpr std::string_view exposition_type = "text/plain; version=0.0.4; charset=utf-8";
/// Letters of a foreign header that an answer repeats.
constexpr std::size_t quoted_bytes_max = 100;

HttpReply refuse(unsigned status, std::string why) {
    HttpReply reply;
    reply.status = status;
    reply.text = std::move(why) + '\n';
    return reply;
}

HttpReply refuse_foreign(unsigned status, Foreign header, std::string why) {
    HttpReply reply = refuse(status, std::move(why));
    reply.foreign = header;
    return reply;
}

std::string quoted(std::string_view text) {
    return std::string("'").append(protocol::clean_text(text, quoted_bytes_max)).append("'");
}

std::string lower(std::string_view text) {
    std::string made(text);
    std::transform(made.begin(), made.end(), made.begin(),
                   [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
    return made;
}

struct HostAndPort {
    std::string_view name;
    std::string_view port;  ///< empty: none
};

/// Splits "name", "name:port", "[v6]" or "[v6]:port".
HostAndPort split_host(std::string_view host) {
    const std::size_t bracket = host.rfind(']');
    const std::size_t colon = host.rfind(':');
    if (colon == std::string_view::npos || (bracket != std::string_view::npos && colon < bracket))
        return {host, {}};
    return {host.substr(0, colon), host.substr(colon + 1)};
}

std::string_view type_of(std::string_view name) {
    struct Type {
        std::string_view ending;
        std::string_view type;
    };
    constexpr std::array types = {
        Type{".html", "text/html; charset=utf-8"},
        Type{".js", "text/javascript; charset=utf-8"},
        Type{".css", "text/css; charset=utf-8"},
        Type{".svg", "image/svg+xml"},
        Type{".png", "image/png"},
    };
    const auto* found =
        std::ranges::find_if(types, [&](const Type& type) { return name.ends_with(type.ending); });
    return found == types.end() ? "application/octet-stream" : found->type;
}

std::string etag_of(std::string_view content) {
    std::array<char, 19> text{};
    (void)std::snprintf(text.data(), text.size(), "\"%016llx\"",
                        static_cast<unsigned long long>(
                            protocol::upload_checksum(std::as_bytes(std::span(content)))));
    return text.data();
}

/// Answers with a file of server/web; its name is the path without its '/'.
HttpReply file(std::string_view path, std::string_view if_none_match) {
    const std::string_view name = path == "/" ? "index.html" : path.substr(1);
    HttpReply reply;
    reply.file = embedded_file("server/web/" + std::string(name));
    if (reply.file.data() == nullptr)
        return refuse(404, "there is no " + quoted(path) + " here; the page is /");
    reply.type = type_of(name);
    reply.etag = etag_of(reply.file);
    const bool known =
        if_none_match == "*" || if_none_match.find(reply.etag) != std::string_view::npos;
    if (known) {
        reply.status = 304;
        reply.file = {};
    }
    return reply;
}

}  // namespace

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

bool HttpSite::is_own_host(std::string_view host) const {
    constexpr std::array<std::string_view, 3> loopback = {"localhost", "127.0.0.1", "[::1]"};
    const std::string whole = lower(host);
    const auto [name, port] = split_host(whole);
    // Browsers leave port 80 out.
    const std::string own_port = std::to_string(port_);
    if (std::ranges::find(loopback, name) != loopback.end() &&
        (port.empty() ? own_port == "80" : port == own_port))
        return true;
    return std::ranges::any_of(names_, [&, name = name](const std::string& allowed) {
        const std::string known = lower(allowed);
        return known == whole || known == name;
    });
}

HttpReply HttpSite::answer(const HttpRequest& request) const {
    if (request.hosts.size() != 1) return refuse(400, "a request needs exactly one Host header");
    if (!is_own_host(request.hosts.front())) {
        const std::string host = protocol::clean_text(request.hosts.front(), quoted_bytes_max);
        return refuse_foreign(
            421, Foreign::host,
            "the host " + quoted(std::string_view(host)) +
                     " is not one of this daemon; open http://127.0.0.1:" + std::to_string(port_) +
                     "/, or start it with --http-host " + std::string(split_host(host).name));
    }
    if (!request.target.starts_with('/'))
        return refuse(400, "a request's target must begin with '/'");
    if (request.method != "GET" && request.method != "HEAD")
        return refuse(405,
                      "only GET and HEAD are served here; requests to trace rays go through "
                      "the WebSocket /v1/stream");
    if (request.has_body) return refuse(413, "a request must not have a body");
    return route(request);
}

HttpReply HttpSite::route(const HttpRequest& request) const {
    // The page keeps its view behind the '?', which only the browser reads.
    const std::string_view path = request.target.substr(0, request.target.find('?'));
    if (path == "/v1/stream") return stream(request);
    if (request.upgrades) return refuse(404, "the WebSocket is /v1/stream");
    if (path == "/healthz") return {.text = "ok\n"};
    if (path == "/readyz") return ready();
    if (path == "/metrics" && metrics_) return metrics(request);
    return file(path, request.if_none_match);
}

HttpReply HttpSite::metrics(const HttpRequest& request) const {
    constexpr std::string_view scheme = "Bearer ";
    std::string_view token = request.authorization;
    token.remove_prefix(token.starts_with(scheme) ? scheme.size() : token.size());
    if (may_see_metrics_ && !may_see_metrics_(token))
        return refuse(401, "/metrics takes a token here: Authorization: Bearer TOKEN");
    return {.type = exposition_type, .text = metrics_()};
}

HttpReply HttpSite::stream(const HttpRequest& request) const {
    if (!request.upgrades)
        return refuse(426, "/v1/stream is a WebSocket; PROTOCOL.md says how it is used");
    const std::string host = lower(request.hosts.front());
    const auto is_own = [&](std::string_view origin) {
        const std::string given = lower(origin);
        return given == "http://" + host || given == "https://" + host;
    };
    if (request.origins.size() != 1 || !is_own(request.origins.front()))
        return refuse_foreign(
            403, Foreign::origin,
            (request.origins.empty() ? "a WebSocket needs an Origin header"
                                          : "the page " + quoted(request.origins.front()) +
                                                " may not open a WebSocket here") +
                     std::string("; its Origin must be http://") +
                     protocol::clean_text(host, quoted_bytes_max));
    if (draining_) return refuse(503, "the daemon is shutting down; try again when it is back");
    HttpReply reply;
    reply.status = 101;
    return reply;
}

HttpReply HttpSite::ready() const {
    const std::string why = draining_  ? "the daemon is shutting down"
                            : unready_ ? unready_()
                                       : std::string();
    return why.empty() ? HttpReply{.text = "ready\n"} : refuse(503, why);
}

}  // namespace raynest::server
