// Answers HTTP requests of any method, target and headers. No request with a foreign Host or Origin
// gets more than a refusal, and each refusal is one printable line.
#include "server/net/http_site.h"
#include "tests/fuzz/target.h"

#include <algorithm>
#include <string>
#include <string_view>

using namespace raynest;
using server::HttpRequest;

namespace {

constexpr std::uint16_t port = 31061;

/// Fields of the input, a line each: method, target, If-None-Match, hosts, an empty line, origins.
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
    while (!text.empty()) request.origins.push_back(line());
    request.upgrades = (flags & 1U) != 0;
    request.has_body = (flags & 2U) != 0;
    return request;
}

std::string lower(std::string_view text) {
    std::string made(text);
    std::ranges::transform(made, made.begin(), [](unsigned char c) {
        return static_cast<char>(c >= 'A' && c <= 'Z' ? c + 32 : c);
    });
    return made;
}

bool is_own(std::string_view host) {
    const std::string known = lower(host);
    return known == "localhost:31061" || known == "127.0.0.1:31061" || known == "[::1]:31061" ||
           known == "ray.example" || known.starts_with("ray.example:");
}

bool is_from_page(const HttpRequest& request) {
    return request.origins.size() == 1 && request.hosts.size() == 1 &&
           lower(request.origins.front()) == "http://" + lower(request.hosts.front());
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
    const HttpRequest request = parse({reinterpret_cast<const char*>(data + 1), size - 1}, data[0]);
    const server::HttpReply reply = site.answer(request);
    if (reply.status < 400) {
        fuzz::require(request.hosts.size() == 1 && is_own(request.hosts.front()));
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
