// Answers HTTP requests of any method, target and headers. No request with a foreign host or Origin
// gets more than a refusal or the answer of a probe, only local requests are answered as local, and
// each refusal is one printable line.
#include "server/http/sender.h"
#include "tests/fuzz/target.h"

#include <algorithm>
#include <string>
#include <string_view>

using namespace raynest;
using server::HttpRequest;
namespace asio = server::asio;

namespace {

constexpr std::uint16_t port = 31061;

/// Fields of the input, a line each: method, target, If-None-Match, hosts, an empty line, origins,
/// an empty line, X-Forwarded-For, -Proto and -Host. The flags: upgrades, has a body, HTTP/1.0,
/// TLS, from a trusted proxy.
HttpRequest parse(std::string_view text, std::uint8_t flags) {
    const auto line = [&] {
        const std::string_view first = text.substr(0, text.find('\n'));
        text.remove_prefix(std::min(text.size(), first.size() + 1));
        return first;
    };
    HttpRequest request;
    request.method = line();
    request.target = line();
    request.if_none_match = line();
    for (std::string_view host = line(); !host.empty(); host = line())
        request.hosts.push_back(host);
    for (std::string_view origin = line(); !origin.empty(); origin = line())
        request.origins.push_back(origin);
    for (auto* headers :
         {&request.forwarded.sender, &request.forwarded.scheme, &request.forwarded.host})
        if (const std::string_view value = line(); !value.empty()) {
            request.forwarded.any = true;
            headers->push_back(value);
        }
    request.upgrades = (flags & 1U) != 0;
    request.has_body = (flags & 2U) != 0;
    request.version = (flags & 4U) != 0 ? 10 : 11;
    request.is_encrypted = (flags & 8U) != 0;
    return request;
}

using server::lower;

bool is_own(std::string_view host) {
    const std::string known = lower(host);
    return known == "localhost:31061" || known == "127.0.0.1:31061" || known == "[::1]:31061" ||
           known == "ray.example" || known.starts_with("ray.example:");
}

/// A text without the usual port of its scheme at its end.
std::string without_port(const std::string& text, std::string_view usual_port) {
    return text.ends_with(usual_port) ? text.substr(0, text.size() - usual_port.size()) : text;
}

bool is_from_page(const HttpRequest& request) {
    if (request.origins.size() != 1 || request.hosts.size() != 1) return false;
    const std::string scheme = request.is_encrypted ? "https://" : "http://";
    const std::string_view usual_port = request.is_encrypted ? ":443" : ":80";
    return without_port(lower(request.origins.front()), usual_port) ==
           without_port(scheme + lower(request.hosts.front()), usual_port);
}

bool is_probe(const HttpRequest& request) {
    const auto path = request.target.substr(0, request.target.find('?'));
    return path == "/healthz" || path == "/readyz";
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    std::vector<Input> seeds;
    for (const std::string_view seed :
         {std::string_view("\4GET\n/\n\n127.0.0.1:31061\n\n"),
          std::string_view("\1GET\n/v1/stream\n\nlocalhost:31061\n\nhttp://localhost:31061"),
          std::string_view("\0POST\n/v1/logout\n\nlocalhost:31061\n\nhttp://localhost:31061", 59),
          std::string_view("\4HEAD\n/main.js\n\"0\"\n[::1]:31061\n\n"),
          std::string_view("\4GET\n/readyz?x\n*\nray.example:9\nray.example\n\nnull\n"),
          std::string_view("\21GET\nhttp://ray.example/v1/stream\n\nx\n\nhttps://ray.example\n\n"
                           "192.0.2.7, 127.0.0.1\nhttps\nray.example:443"),
          std::string_view("\4GET\n/healthz\n\n\n\n"),
          std::string_view("\2POST\n/metrics\n\nevil.example\n\nhttp://evil.example")})
        seeds.emplace_back(seed.begin(), seed.end());
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static server::HttpSite site = [] {
        server::HttpSite made({"ray.example"});
        made.set_address({"127.0.0.1", port, "http"});
        return made;
    }();
    if (size == 0) return 0;
    HttpRequest request = parse({reinterpret_cast<const char*>(data + 1), size - 1}, data[0]);
    static const server::AddressSet proxies({"127.0.0.1"});
    const bool is_told = request.forwarded.any;
    server::find_sender(
        request, asio::ip::make_address((data[0] & 16U) != 0 ? "127.0.0.1" : "127.0.0.2"), proxies);
    const bool is_local = request.sender.place == server::PeerIdentity::Place::loopback;
    fuzz::require(!is_local || (!is_told && request.hosts.size() == 1 &&
                                !lower(request.hosts.front()).starts_with("ray.example")));
    const server::HttpReply reply = site.answer(request);
    if (reply.status < 400) {
        fuzz::require(is_probe(request) ||
                      (request.hosts.size() == 1 && is_own(request.hosts.front())));
        fuzz::require(request.method == "GET" || request.method == "HEAD" ||
                      (request.method == "POST" && is_from_page(request)));
    } else {
        fuzz::require(std::ranges::count(reply.text, '\n') == 1 && reply.text.back() == '\n');
        fuzz::require(std::ranges::none_of(
            reply.text, [](unsigned char c) { return c != '\n' && (c < 32 || c == 127); }));
    }
    if (reply.status == 101) fuzz::require(is_from_page(request));
    return 0;
}
