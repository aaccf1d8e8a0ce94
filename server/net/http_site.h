// The daemon's answers over HTTP, without sockets.
//
//   HttpRequest ──► allowed Host? ──► route: a file of server/web, /healthz, /readyz, /metrics,
//                                        │                 /v1/stream
//                                        │
//                                        └─► HttpReply, which http.cpp writes
//
// Host must be a name of ours, so that no foreign name that leads to this address can be used to
// read it (DNS rebinding); Origin of a WebSocket must be this page's, since browsers let any page
// open one.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// The parts of a request that decide the answer. The views are valid during answer() only.
struct HttpRequest {
    std::string_view method;
    std::string_view target;
    std::vector<std::string_view> hosts;    ///< every Host header
    std::vector<std::string_view> origins;  ///< every Origin header
    std::string_view if_none_match;
    bool upgrades = false;  ///< asks for a WebSocket
    bool has_body = false;
    std::string_view authorization = {};  ///< "Bearer TOKEN"
};

/// The header because of which a request is refused as foreign.
enum class Foreign : std::uint8_t { none, host, origin };

struct HttpReply {
    /// 101: the connection becomes a WebSocket.
    unsigned status = 200;
    std::string_view type = "text/plain; charset=utf-8";
    std::string text;            ///< the body, unless `file` has it
    std::string_view file = {};  ///< an embedded file
    std::string etag = {};       ///< empty: not to be kept by the client
    Foreign foreign = Foreign::none;

    [[nodiscard]] std::string_view body() const { return file.empty() ? text : file; }
};

class HttpSite {
public:
    /// `names` are allowed hosts besides loopback: NAME allows it with every port, NAME:PORT with
    /// one.
    explicit HttpSite(std::vector<std::string> names) : names_(std::move(names)) {}

    /// Sets the port listened on, which loopback hosts must name.
    void set_port(std::uint16_t port) { port_ = port; }
    /// Sets the answer of /readyz: an empty text if requests are served, else why not.
    void set_unready(std::function<std::string()> unready) { unready_ = std::move(unready); }
    /// Sets the answer of /metrics.
    void set_metrics(std::function<std::string()> metrics) { metrics_ = std::move(metrics); }
    /// Shows /metrics only to those whose bearer token `may_see` accepts.
    void guard_metrics(std::function<bool(std::string_view token)> may_see) {
        may_see_metrics_ = std::move(may_see);
    }
    /// Refuses new WebSockets, because the daemon ends.
    void drain() { draining_ = true; }

    [[nodiscard]] HttpReply answer(const HttpRequest& request) const;

private:
    [[nodiscard]] bool is_own_host(std::string_view host) const;
    [[nodiscard]] HttpReply route(const HttpRequest& request) const;
    [[nodiscard]] HttpReply stream(const HttpRequest& request) const;
    [[nodiscard]] HttpReply ready() const;
    [[nodiscard]] HttpReply metrics(const HttpRequest& request) const;

    const std::vector<std::string> names_;
    std::uint16_t port_ = 0;
    std::function<std::string()> unready_;
    std::function<std::string()> metrics_;
    std::function<bool(std::string_view)> may_see_metrics_;  ///< empty: everybody may
    bool draining_ = false;
};

/// True for what --http-host takes: a host name or address, perhaps with a port.
[[nodiscard]] bool is_http_host(std::string_view text);

}  // namespace raynest::server
