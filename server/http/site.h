// The daemon's answers over HTTP, without sockets.
//
//   HttpRequest ──► allowed Host? ──► known sender? ──► route: a file of server/web, /metrics,
//        │                               │                 /v1/login, /v1/logout, /v1/stream
//        └─► /healthz, /readyz           │
//                                        └─► HttpReply, which http.cpp writes
//
// Probes reach /healthz and /readyz under any host: they name the address of a machine or none.
// Host must be a name of ours, so that no foreign name that leads to this address can be used to
// read it (DNS rebinding); Origin of a WebSocket and of a login must be this page's, since browsers
// let any page open one.
#pragma once

#include "server/ground/address.h"
#include "server/ground/errors.h"
#include "server/security/principal.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

/// Headers in which proxies tell who has sent a request.
struct ForwardedHeaders {
    bool any = false;  ///< one of those below, or another that only proxies send
    std::vector<std::string_view> sender = {};  ///< every X-Forwarded-For
    std::vector<std::string_view> scheme = {};  ///< every X-Forwarded-Proto
    std::vector<std::string_view> host = {};    ///< every X-Forwarded-Host
};

/// The parts of a request that decide the answer. The views are valid during answer() only.
struct HttpRequest {
    std::string_view method;
    std::string_view target;
    std::vector<std::string_view> hosts;    ///< every Host header, or the host that counts
    std::vector<std::string_view> origins;  ///< every Origin header
    std::string_view if_none_match;
    bool upgrades = false;                       ///< asks for a WebSocket
    bool has_body = false;                       ///< has one that was not read
    std::string_view authorization = {};         ///< "Bearer TOKEN"
    std::vector<std::string_view> cookies = {};  ///< every Cookie header
    std::string_view body = {};
    unsigned version = 11;  ///< the version of HTTP, times ten
    /// Names of the connection's certificate, which are allowed hosts with the port listened on.
    std::span<const std::string> certificate_names = {};
    ForwardedHeaders forwarded = {};
    PeerIdentity sender = {};   ///< the peer of the connection, until find_sender() (http_sender.h)
    bool is_encrypted = false;  ///< the sender's address of the page begins with https://

    [[nodiscard]] bool may_lack_host() const { return version < 11 && hosts.empty(); }
};

/// Returns a text with A to Z in lower case.
[[nodiscard]] std::string lower(std::string_view text);

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
    std::string cookie = {};                       ///< Set-Cookie
    std::string_view allow = "GET, HEAD";          ///< for status 405
    unsigned retry_after_s = 0;                    ///< 0: not said
    std::shared_ptr<const Principal> sender = {};  ///< for status 101

    [[nodiscard]] std::string_view body() const { return file.empty() ? text : file; }
};

/// Decides who may see what. `bearer` and `cookie` are what a request shows: a token, and the
/// secret of a login; either may be empty.
class HttpAccess {
public:
    HttpAccess() = default;
    HttpAccess(const HttpAccess&) = delete;

    /// Fails with NOT_ALLOWED or BUSY where the peer must log in first.
    virtual Reply<Principal> identify(const PeerIdentity& peer, std::string_view bearer,
                                      std::string_view cookie) = 0;
    /// Returns the question that must be answered before this code logs the page in, in the place of
    /// this cookie or the peer's certificate, if any; empty: none.
    virtual std::string question_before(const PeerIdentity& peer, std::string_view code,
                                        std::string_view cookie) = 0;
    /// Begins a login by a token or else by a code. Returns the secret of its cookie.
    virtual Reply<std::string> log_in(const PeerIdentity& peer, std::string_view token,
                                      std::string_view code) = 0;
    /// Ends a login and its WebSockets.
    virtual void log_out(std::string_view cookie) = 0;

protected:
    ~HttpAccess() = default;
};

class HttpSite {
public:
    /// `names` are allowed hosts besides loopback: NAME allows it with every port, NAME:PORT with
    /// one.
    explicit HttpSite(std::vector<std::string> names) : names_(std::move(names)) {}

    void set_names(std::vector<std::string> names) { names_ = std::move(names); }
    /// Sets the address listened on. Loopback hosts must name its port.
    void set_address(const TcpAddress& address) { address_ = address; }
    /// Sets the answer of /readyz: an empty text if requests are served, else why not.
    void set_unready(std::function<std::string()> unready) { unready_ = std::move(unready); }
    /// Sets what /healthz adds to its answer: what the daemon is short of; empty: nothing.
    void set_shortage(std::function<std::string()> shortage) { shortage_ = std::move(shortage); }
    /// Sets the answer of /metrics to a sender.
    void set_metrics(std::function<std::string(const Principal&)> metrics) {
        metrics_ = std::move(metrics);
    }
    /// Asks this who may see the page. Without it everybody may. Must outlive the site.
    void set_access(HttpAccess& access) { access_ = &access; }
    /// Refuses new WebSockets, because the daemon ends.
    void drain() { draining_ = true; }

    /// True if the body of this request is to be read before answer().
    [[nodiscard]] bool takes_body(const HttpRequest& request) const;
    [[nodiscard]] HttpReply answer(const HttpRequest& request) const;

private:
    /// True for a host under which the page may be opened.
    [[nodiscard]] bool is_own_host(const HttpRequest& request) const;
    /// True if the request comes from this page: it has one Origin header, with our scheme and
    /// host.
    [[nodiscard]] bool is_from_page(const HttpRequest& request) const;
    [[nodiscard]] HttpReply refuse_origin(const HttpRequest& request) const;
    [[nodiscard]] HttpReply route(const HttpRequest& request) const;
    [[nodiscard]] HttpReply post(const HttpRequest& request, std::string_view path) const;
    [[nodiscard]] HttpReply log_in(const HttpRequest& request) const;
    /// Tells the sender who it is.
    [[nodiscard]] HttpReply tell(const HttpRequest& request) const;
    [[nodiscard]] HttpReply page(const HttpRequest& request, std::string_view path) const;
    [[nodiscard]] HttpReply stream(const HttpRequest& request) const;
    [[nodiscard]] HttpReply ready() const;
    [[nodiscard]] HttpReply health() const;
    [[nodiscard]] HttpReply metrics(const HttpRequest& request) const;
    [[nodiscard]] Reply<Principal> identify(const HttpRequest& request) const;
    /// Returns the secret of the login in the request's cookies; empty if there is none.
    /// Returns the secrets of the cookies that have the name of a login.
    [[nodiscard]] std::set<std::string_view> logins_of(const HttpRequest& request) const;
    [[nodiscard]] std::string_view login_of(const HttpRequest& request) const;
    /// Returns Set-Cookie for a secret; an empty one takes the cookie away.
    [[nodiscard]] std::string cookie_with(const HttpRequest& request,
                                          std::string_view secret) const;
    /// The name has the port, because browsers send a cookie to every port of a host.
    [[nodiscard]] std::string cookie_name(const HttpRequest& request) const;

    std::vector<std::string> names_;
    TcpAddress address_{"127.0.0.1", 0, "http"};
    std::function<std::string()> unready_;
    std::function<std::string()> shortage_;
    std::function<std::string(const Principal&)> metrics_;
    HttpAccess* access_ = nullptr;
    bool draining_ = false;
};

}  // namespace raynest::server
