#include "server/http/site.h"

#include "protocol/hash.h"
#include "protocol/text.h"
#include "server/http/embedded.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <utility>

namespace raynest::server {
namespace {

/// Media type of Prometheus' text format.
constexpr std::string_view exposition_type = "text/plain; version=0.0.4; charset=utf-8";
constexpr std::string_view json_type = "application/json";
/// Letters of a foreign header that an answer repeats.
constexpr std::size_t quoted_bytes_max = 100;
constexpr std::string_view login_path = "/v1/login";
constexpr std::string_view logout_path = "/v1/logout";
/// Files that everybody may read: the form that asks for the token.
constexpr std::array<std::string_view, 8> open_files = {"/login.html", "/login.js", "/session.js",
                                                        "/dom.js",     "/theme.js", "/settings.js",
                                                        "/style.css",  "/icon.svg"};

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

/// The answer to a request whose sender must log in first, or must wait.
HttpReply refuse_sender(const protocol::Error& error) {
    const bool waits = error.code == Code::busy;
    HttpReply reply = refuse(waits ? 429 : 401, error.message);
    if (waits) reply.retry_after_s = error.retry_after_ms / 1000 + 1;
    return reply;
}

std::string quoted(std::string_view text) {
    return std::string("'").append(protocol::clean_text(text, quoted_bytes_max)).append("'");
}

std::string_view scheme_of(const HttpRequest& request) {
    return request.is_encrypted ? "https" : "http";
}

/// Returns SCHEME://HOST as browsers write an Origin: in lower case, and without the usual port.
std::string to_origin(std::string_view scheme, std::string_view host) {
    const std::string known = lower(scheme);
    const std::string_view usual_port = known == "https" ? ":443" : ":80";
    if (host.ends_with(usual_port)) host.remove_suffix(usual_port.size());
    return known + "://" + lower(host);
}

std::string own_origin(const HttpRequest& request) {
    return to_origin(scheme_of(request), request.hosts.front());
}

/// Returns the path without what follows '?', which only the browser reads.
std::string_view path_of(const HttpRequest& request) {
    return request.target.substr(0, request.target.find('?'));
}

/// Returns a field of "name=value&name=value". Tokens and codes have no letter to decode.
std::string_view form_field(std::string_view form, std::string_view name) {
    while (!form.empty()) {
        const std::string_view part = form.substr(0, form.find('&'));
        form.remove_prefix(std::min(form.size(), part.size() + 1));
        if (part.starts_with(name) && part.substr(name.size()).starts_with('='))
            return part.substr(name.size() + 1);
    }
    return {};
}

/// True if a name of a certificate, which may begin with "*.", is this host.
bool certificate_has(std::string_view name, std::string_view host) {
    if (!name.starts_with("*.")) return name == host;
    const std::size_t dot = host.find('.');
    return dot != std::string_view::npos && dot != 0 && name.substr(1) == host.substr(dot);
}

/// Returns the token of "Bearer TOKEN"; the scheme may be in any case (RFC 9110, 11.1).
std::string_view bearer_of(std::string_view authorization) {
    constexpr std::string_view scheme = "bearer ";
    if (lower(authorization.substr(0, scheme.size())) != scheme) return {};
    authorization.remove_prefix(scheme.size());
    const std::size_t first = authorization.find_first_not_of(' ');
    return first == std::string_view::npos ? std::string_view() : authorization.substr(first);
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

std::string lower(std::string_view text) {
    std::string made(text);
    std::transform(made.begin(), made.end(), made.begin(),
                   [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
    return made;
}

bool HttpSite::is_own_host(const HttpRequest& request) const {
    constexpr std::array<std::string_view, 3> loopback = {"localhost", "127.0.0.1", "[::1]"};
    const std::string whole = lower(request.hosts.front());
    const auto [name, port] = split_host(whole);
    // Browsers leave the usual port out.
    const std::string own_port = std::to_string(address_.port);
    const std::string_view usual_port = request.is_encrypted ? "443" : "80";
    if (port.empty() ? own_port == usual_port : port == own_port) {
        const bool is_v6 = address_.host.find(':') != std::string::npos;
        const std::string own = is_v6 ? "[" + address_.host + "]" : address_.host;
        const bool is_any = own == "0.0.0.0" || own == "[::]";
        if (std::ranges::find(loopback, name) != loopback.end() || (!is_any && name == own))
            return true;
        std::string_view bare = name;
        if (bare.starts_with('[') && bare.ends_with(']')) bare = bare.substr(1, bare.size() - 2);
        if (std::ranges::any_of(request.certificate_names, [&](const std::string& known) {
                return certificate_has(lower(known), bare);
            }))
            return true;
    }
    return std::ranges::any_of(names_, [&, name = name](const std::string& allowed) {
        const std::string known = lower(allowed);
        return known == name || to_origin(scheme_of(request), known) == own_origin(request);
    });
}

HttpReply HttpSite::answer(const HttpRequest& request) const {
    const std::string_view path = path_of(request);
    const bool is_probe = path == "/healthz" || path == "/readyz";
    if (request.hosts.size() != 1 && !(is_probe && request.may_lack_host()))
        return refuse(400, "a request needs exactly one Host header");
    if (!is_probe && !is_own_host(request)) {
        const std::string host = protocol::clean_text(request.hosts.front(), quoted_bytes_max);
        const std::string name(split_host(host).name);
        const std::string page =
            address_.scheme + "://127.0.0.1:" + std::to_string(address_.port) + "/";
        return refuse_foreign(421, Foreign::host,
                              name.empty()
                                  ? "the request's host is empty; open " + page +
                                        ", or have the proxy name a host that --http-host allows"
                                  : "the host " + quoted(std::string_view(host)) +
                                        " is not one of this daemon; open " + page +
                                        ", or start it with --http-host " + name);
    }
    // Others on this host, at another port, can set a cookie beside that of the page.
    if (logins_of(request).size() > 1) {
        HttpReply reply = refuse(400,
                                 "the browser sends several logins of this page; log in again, "
                                 "and if that does not help, delete the cookies of this host");
        reply.cookie = cookie_with(request, "");
        return reply;
    }
    if (!request.target.starts_with('/'))
        return refuse(400, "a request's target must begin with '/' or http://");
    const bool is_login = path == login_path || path == logout_path;
    if (request.method == "POST" && is_login) return post(request, path);
    if (request.method != "GET" && request.method != "HEAD") {
        HttpReply reply = refuse(405,
                                 "only GET and HEAD are served here; requests to trace rays go "
                                 "through the WebSocket /v1/stream");
        if (is_login) reply.allow = "GET, HEAD, POST";
        return reply;
    }
    if (request.has_body) return refuse(413, "a request must not have a body");
    return route(request);
}

HttpReply HttpSite::route(const HttpRequest& request) const {
    const std::string_view path = path_of(request);
    if (path == "/v1/stream") return stream(request);
    if (request.upgrades) return refuse(404, "the WebSocket is /v1/stream");
    if (path == "/healthz") return health();
    if (path == "/readyz") return ready();
    if (path == login_path) return tell(request);
    if (path == logout_path) {
        HttpReply reply = refuse(405, "a login ends by POST");
        reply.allow = "POST";
        return reply;
    }
    if (path == "/metrics" && metrics_) return metrics(request);
    return page(request, path);
}

HttpReply HttpSite::page(const HttpRequest& request, std::string_view path) const {
    if (std::ranges::find(open_files, path) != open_files.end())
        return file(path, request.if_none_match);
    const auto sender = identify(request);
    if (sender) return file(path, request.if_none_match);
    HttpReply refused = refuse_sender(sender.error());
    if (path != "/" && path != "/index.html") return refused;
    // The browser shows the form in the place of the page.
    HttpReply form = file("/login.html", "");
    form.status = refused.status;
    form.etag = {};
    form.retry_after_s = refused.retry_after_s;
    return form;
}

// ---- logins -------------------------------------------------------------------------------------

bool HttpSite::is_from_page(const HttpRequest& request) const {
    if (request.origins.size() != 1) return false;
    const std::string_view origin = request.origins.front();
    const std::size_t slashes = origin.find("://");
    return slashes != std::string_view::npos &&
           to_origin(origin.substr(0, slashes), origin.substr(slashes + 3)) == own_origin(request);
}

HttpReply HttpSite::refuse_origin(const HttpRequest& request) const {
    const bool is_plain_behind_tls = !request.is_encrypted && request.origins.size() == 1 &&
                                     lower(request.origins.front()).starts_with("https://");
    return refuse_foreign(
        403, Foreign::origin,
        (request.origins.empty()
             ? "this request needs an Origin header"
             : "the page " + quoted(request.origins.front()) + " may not send this request") +
            "; its Origin must be " + protocol::clean_text(own_origin(request), quoted_bytes_max) +
            (is_plain_behind_tls
                 ? "; if TLS ends at a proxy, start the daemon with --trusted-proxy "
                   "ADDRESS, and let the proxy send X-Forwarded-Proto"
                 : ""));
}

bool HttpSite::takes_body(const HttpRequest& request) const {
    return request.method == "POST" && path_of(request) == login_path &&
           request.hosts.size() == 1 && is_own_host(request) && is_from_page(request);
}

HttpReply HttpSite::post(const HttpRequest& request, std::string_view path) const {
    if (!is_from_page(request)) return refuse_origin(request);
    if (request.has_body) return refuse(413, "the body of a login is token=TOKEN or code=CODE");
    if (path == login_path) return log_in(request);
    if (access_ != nullptr) access_->log_out(login_of(request));
    HttpReply reply{.text = "logged out\n"};
    reply.cookie = cookie_with(request, "");
    return reply;
}

HttpReply HttpSite::log_in(const HttpRequest& request) const {
    const std::string_view token = form_field(request.body, "token");
    const std::string_view code = form_field(request.body, "code");
    if (token.empty() == code.empty())
        return refuse(400, "the body of a login is token=TOKEN or code=CODE");
    if (access_ == nullptr) return refuse(404, "nobody needs to log in here");
    const std::string_view old_login = login_of(request);
    const std::string question = access_->question_before(request.sender, code, old_login);
    if (!question.empty() && form_field(request.body, "agreed") != "yes")
        return refuse(409, question + "; send agreed=yes, too, if the user agrees");
    const auto secret = access_->log_in(request.sender, token, code);
    if (!secret) return refuse_sender(secret.error());
    // The browser forgets its old login now. A code of the same user may come from it, and then the
    // new one goes with it.
    if (!question.empty() || !token.empty()) access_->log_out(old_login);
    HttpReply reply{.text = "logged in\n"};
    reply.cookie = cookie_with(request, *secret);
    return reply;
}

HttpReply HttpSite::tell(const HttpRequest& request) const {
    const auto sender = identify(request);
    if (!sender) return refuse_sender(sender.error());
    std::string principal;
    for (const char c : sender->id) {
        if (c == '"' || c == '\\') principal += '\\';
        principal += c;
    }
    return {.type = json_type,
            .text = "{\"principal\":\"" + principal + "\",\"role\":\"" +
                    std::string(role_name(sender->role)) +
                    "\",\"login\":" + (sender->page_login != 0 ? "true" : "false") + "}\n"};
}

Reply<Principal> HttpSite::identify(const HttpRequest& request) const {
    if (access_ == nullptr) return Principal{};
    return access_->identify(request.sender, bearer_of(request.authorization), login_of(request));
}

std::string HttpSite::cookie_name(const HttpRequest& request) const {
    // Browsers take a cookie of this prefix from the host itself alone, and over TLS.
    return (request.is_encrypted ? "__Host-raynest-" : "raynest-") + std::to_string(address_.port);
}

std::set<std::string_view> HttpSite::logins_of(const HttpRequest& request) const {
    const std::string name = cookie_name(request);
    std::set<std::string_view> logins;
    for (std::string_view cookies : request.cookies) {
        while (!cookies.empty()) {
            std::string_view part = cookies.substr(0, cookies.find(';'));
            cookies.remove_prefix(std::min(cookies.size(), part.size() + 1));
            part.remove_prefix(std::min(part.size(), part.find_first_not_of(' ')));
            if (part.starts_with(name) && part.substr(name.size()).starts_with('='))
                logins.insert(part.substr(name.size() + 1));
        }
    }
    return logins;
}

std::string_view HttpSite::login_of(const HttpRequest& request) const {
    const auto logins = logins_of(request);
    return logins.empty() ? std::string_view() : *logins.begin();
}

std::string HttpSite::cookie_with(const HttpRequest& request, std::string_view secret) const {
    return cookie_name(request) + "=" + std::string(secret) +
           "; Path=/; HttpOnly; SameSite=Strict" + (request.is_encrypted ? "; Secure" : "") +
           (secret.empty() ? "; Max-Age=0" : "");
}

// ---- the daemon ---------------------------------------------------------------------------------

HttpReply HttpSite::metrics(const HttpRequest& request) const {
    const auto sender = identify(request);
    if (!sender)
        return sender.error().code == Code::busy
                   ? refuse_sender(sender.error())
                   : refuse(401, "/metrics takes a token here: Authorization: Bearer TOKEN");
    return {.type = exposition_type, .text = metrics_(*sender)};
}

HttpReply HttpSite::stream(const HttpRequest& request) const {
    if (!request.upgrades)
        return refuse(426, "/v1/stream is a WebSocket; PROTOCOL.md says how it is used");
    if (!is_from_page(request)) return refuse_origin(request);
    if (draining_) return refuse(503, "the daemon is shutting down; try again when it is back");
    auto sender = identify(request);
    if (!sender) return refuse_sender(sender.error());
    HttpReply reply;
    reply.status = 101;
    if (access_ != nullptr) reply.sender = std::make_shared<const Principal>(std::move(*sender));
    return reply;
}

// A daemon that is short of something lives: a restart would help nobody.
HttpReply HttpSite::health() const {
    const std::string shortage = shortage_ ? shortage_() : std::string();
    return {.text = "ok\n" + (shortage.empty() ? shortage : shortage + '\n')};
}

HttpReply HttpSite::ready() const {
    const std::string why = draining_  ? "the daemon is shutting down"
                            : unready_ ? unready_()
                                       : std::string();
    return why.empty() ? HttpReply{.text = "ready\n"} : refuse(503, why);
}

}  // namespace raynest::server
