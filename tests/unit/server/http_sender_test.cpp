#include "server/http/sender.h"

#include <doctest/doctest.h>

#include <string>
#include <vector>

namespace raynest::server {
namespace {

using Place = PeerIdentity::Place;

const char* const here = "127.0.0.1";
const char* const far = "192.0.2.7";

/// A request as it comes over plain HTTP from an address.
struct Arrival {
    explicit Arrival(const std::string& from, std::string_view host = "127.0.0.1:31061")
        : address(asio::ip::make_address(from)) {
        request.method = "GET";
        request.target = "/";
        request.hosts = {host};
        request.sender = {from, address.is_loopback() ? Place::loopback : Place::remote, "http"};
    }
    Arrival& told(std::vector<std::string_view> sender, std::vector<std::string_view> scheme = {},
                  std::vector<std::string_view> host = {}) {
        request.forwarded = {true, std::move(sender), std::move(scheme), std::move(host)};
        return *this;
    }
    const HttpRequest& judged(const AddressSet& proxies = {}) {
        find_sender(request, address, proxies);
        return request;
    }
    HttpRequest request;
    asio::ip::address address;
};

TEST_CASE("a set of addresses has addresses and networks, and refuses other texts") {
    const AddressSet set({"192.0.2.7", "10.16.0.0/12", "2001:db8::/33", "::1"});
    const auto has = [&](const char* text) { return set.contains(asio::ip::make_address(text)); };
    for (const char* member : {"192.0.2.7", "::ffff:192.0.2.7", "10.16.0.0", "10.31.255.255", "::1",
                               "2001:db8::", "2001:db8:7fff::1"})
        CHECK_MESSAGE(has(member), member);
    for (const char* other : {"192.0.2.6", "192.0.2.8", "10.15.255.255", "10.32.0.0", "127.0.0.1",
                              "2001:db8:8000::", "2001:db9::", "::"})
        CHECK_MESSAGE(!has(other), other);
    for (const char* text : {"", "localhost", "10.0.0.1/33", "10.0.0.1/", "10.0.0.1/-1", "10.0.0/8",
                             "::1/129", "10.0.0.1/8/8", "10.0.0.1/8", "192.0.2.129/25",
                             "2001:db8::1/64", "10.0.0.1 ", "0.0.0.0/0", "::/0", "::ffff:0:0/96"})
        CHECK_MESSAGE(!AddressSet().add(text).empty(), text);
    // The addresses of IPv4 have a place among those of IPv6, but a network of those means none of them.
    const AddressSet wide({"::/1", "::/80"});
    CHECK(wide.contains(asio::ip::make_address("::1")));
    CHECK_FALSE(wide.contains(asio::ip::make_address("10.1.2.3")));
    CHECK_FALSE(wide.contains(asio::ip::make_address("::ffff:10.1.2.3")));
    CHECK(AddressSet({"::ffff:10.0.0.0/104"}).contains(asio::ip::make_address("10.1.2.3")));
}

TEST_CASE("a request is local from loopback, for a loopback host and without a trace of a proxy") {
    for (const char* host :
         {"127.0.0.1:31061", "localhost", "LOCALHOST:9", "[::1]:31061", "127.0.0.2"})
        CHECK(Arrival(here, host).judged().sender.place == Place::loopback);
    for (const char* host : {"gpu.example.org", "127.0.0.1.evil.example:31061", "localhost.evil",
                             "192.0.2.1", "127.1", "[::2]", "", "localhost."})
        CHECK_MESSAGE(Arrival(here, host).judged().sender.place == Place::remote, host);
    CHECK(Arrival(far).judged().sender.place == Place::remote);
    // A proxy may pass on an absolute target that a client chose.
    Arrival absolute(here, "gpu.example.org");
    absolute.request.target = "http://127.0.0.1:31061/";
    CHECK(absolute.judged().sender.place == Place::remote);
    CHECK(Arrival(here).told({}).judged().sender.place == Place::remote);
    // Its own word does not make a sender local.
    CHECK(Arrival(here).told({"127.0.0.1"}).judged(AddressSet({here})).sender.place ==
          Place::remote);
    CHECK(Arrival(far).told({"127.0.0.1"}).judged(AddressSet({far})).sender.place == Place::remote);
    for (const char* header : {"Forwarded",
                               "X-Forwarded-For",
                               "x-forwarded-proto",
                               "X-FORWARDED-SERVER",
                               "Via",
                               "X-Real-IP",
                               "CF-Connecting-IP",
                               "True-Client-IP",
                               "X-Original-Host",
                               "WL-Proxy-Client-IP",
                               "X-Vercel-Forwarded-For",
                               "DO-Connecting-IP",
                               "X-NginX-Proxy",
                               "Surrogate-Capability",
                               "CloudFront-Viewer-Address",
                               "Incap-Client-IP",
                               "X-Sucuri-ClientIP",
                               "X-Appengine-User-Ip",
                               "X-Nf-Client-Connection-Ip",
                               "X_Forwarded_For",
                               "X-BlueCoat-Via",
                               "X-Remote-Addr",
                               "CDN-Loop",
                               "X-ARR-Log-Id",
                               "Proxy-Connection",
                               "X-Varnish",
                               "X-Amzn-Trace-Id",
                               "X-Envoy-Internal"})
        CHECK_MESSAGE(is_from_proxies(header), header);
    // Browsers send these by themselves.
    for (const char* header : {"Host",
                               "User-Agent",
                               "X-Requested-With",
                               "Origin",
                               "Referer",
                               "X-Real",
                               "Accept-Encoding",
                               "Connection",
                               "Upgrade",
                               "Upgrade-Insecure-Requests",
                               "Cookie",
                               "DNT",
                               "Device-Memory",
                               "Downlink",
                               "If-None-Match",
                               "Origin-Agent-Cluster",
                               "Pragma",
                               "Priority",
                               "RTT",
                               "Range",
                               "Save-Data",
                               "Sec-CH-UA-Platform",
                               "Sec-CH-Viewport-Width",
                               "Sec-Fetch-Site",
                               "Sec-GPC",
                               "Sec-Purpose",
                               "Sec-WebSocket-Extensions",
                               "Sec-WebSocket-Protocol",
                               "Service-Worker",
                               "TE",
                               "Viewport-Width",
                               "X-Client-Data",
                               "Authorization",
                               "Content-Length",
                               "Transfer-Encoding"})
        CHECK_MESSAGE(!is_from_proxies(header), header);
}

TEST_CASE("the sender is the last hop that is no trusted proxy") {
    const AddressSet proxies({here, "10.0.0.0/8"});
    struct Row {
        std::vector<std::string_view> told;
        const char* name;
    };
    const std::vector<Row> rows = {
        {{"198.51.100.4"}, "198.51.100.4"},
        {{"203.0.113.9, 198.51.100.4"}, "198.51.100.4"},  // the first one is the sender's own word
        {{"203.0.113.9", "198.51.100.4"}, "198.51.100.4"},
        {{"198.51.100.4, 10.1.2.3"}, "198.51.100.4"},
        {{" 198.51.100.4 ,10.1.2.3, 127.0.0.1"}, "198.51.100.4"},
        {{"10.1.2.3, 10.1.2.4"}, "10.1.2.3"},
        {{"198.51.100.4:5123"}, "198.51.100.4"},
        {{"[2001:db8::5]:5123"}, "2001:db8::/64"},
        {{"2001:db8::5"}, "2001:db8::/64"},
        {{"198.51.100.4, unknown"}, here},
        {{"198.51.100.4,"}, here},
        {{""}, here},
        {{}, here},
    };
    for (const Row& row : rows) {
        CHECK(Arrival(here).told(row.told).judged(proxies).sender.name == row.name);
        // From others it is a text that anybody can send.
        CHECK(Arrival(far).told(row.told).judged(proxies).sender.name == far);
        CHECK(Arrival(here).told(row.told).judged().sender.name == here);
    }
}

TEST_CASE("scheme and host of a trusted proxy count, and its certificate is not the sender's") {
    const AddressSet proxies({here});
    Arrival trusted(here);
    trusted.request.sender.subject = "CN=proxy";
    trusted.told({far}, {"http, https"}, {"a.example, gpu.example.org:443"}).judged(proxies);
    CHECK(trusted.request.is_encrypted);
    CHECK(trusted.request.hosts == std::vector<std::string_view>{"gpu.example.org:443"});
    CHECK(trusted.request.sender.subject.empty());
    // A wrong number of hosts stays one, whatever the proxy says.
    Arrival twice(here);
    twice.request.hosts = {"a.example", "b.example"};
    CHECK(twice.told({far}, {}, {"gpu.example.org"}).judged(proxies).hosts.size() == 2);
    Arrival none(here);
    none.request.hosts.clear();
    CHECK(none.told({far}, {}, {"gpu.example.org"}).judged(proxies).hosts.empty());
    Arrival plain(here);
    plain.request.is_encrypted = true;  // TLS from the proxy to the daemon
    CHECK_FALSE(plain.told({far}, {"http"}).judged(proxies).is_encrypted);
    Arrival stranger(far);
    stranger.request.sender.subject = "CN=robot";
    stranger.told({here}, {"https"}, {"gpu.example.org"}).judged(proxies);
    CHECK_FALSE(stranger.request.is_encrypted);
    CHECK(stranger.request.hosts == std::vector<std::string_view>{"127.0.0.1:31061"});
    CHECK(stranger.request.sender.subject == "CN=robot");
}

TEST_CASE("the host of an absolute target counts in place of Host, and is judged like it") {
    struct Row {
        const char* target;
        const char* host;
        const char* path;
        Place place;
    };
    for (const Row& row :
         {Row{"http://127.0.0.1:31061/x?y", "127.0.0.1:31061", "/x?y", Place::loopback},
          Row{"HTTP://localhost:9", "localhost:9", "/", Place::loopback},
          Row{"http://localhost?x", "localhost", "/", Place::loopback},
          Row{"https://evil.example/", "evil.example", "/", Place::remote},
          Row{"http://localhost@evil.example/", "localhost@evil.example", "/", Place::remote},
          Row{"http:///x", "", "/x", Place::remote}}) {
        Arrival arrival(here, "[::1]:31061");
        arrival.request.target = row.target;
        CHECK(arrival.judged().hosts == std::vector<std::string_view>{row.host});
        CHECK(arrival.request.target == row.path);
        CHECK(arrival.request.sender.place == row.place);
    }
    Arrival twice(here);
    twice.request.hosts.push_back("localhost");
    twice.request.target = "http://localhost/";
    CHECK(twice.judged().hosts.size() == 2);
    CHECK(twice.request.sender.place == Place::remote);
    Arrival other(here);
    other.request.target = "ftp://localhost/";
    CHECK(other.judged().target == "ftp://localhost/");
}

}  // namespace
}  // namespace raynest::server
