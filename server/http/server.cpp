#include "server/http/server.h"

#include "protocol/keep_alive.h"
#include "server/ground/io_turn.h"
#include "server/ground/limited_log.h"
#include "server/http/messages.h"
#include "server/http/sender.h"
#include "server/http/stream.h"
#include "server/http/websocket_transport.h"
#include "server/net/socket_transport.h"
#include "server/net/turns.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <iterator>
#include <limits>
#include <map>
#include <new>
#include <optional>
#include <vector>

namespace raynest::server {
namespace {

using std::chrono::milliseconds;

/// Time for a client to read the last answer and to close.
constexpr milliseconds linger_time{1000};
/// Bytes of a body, which logins alone have.
constexpr std::uint64_t body_bytes_max = 4096;

std::string_view view(beast::string_view text) {
    return {text.data(), text.size()};
}

beast::string_view view(std::string_view text) {
    return {text.data(), text.size()};
}

template <class Name>
std::vector<std::string_view> values(const PageRequest& request, Name name) {
    std::vector<std::string_view> found;
    const auto [first, last] = request.equal_range(name);
    for (auto field = first; field != last; ++field) found.push_back(view(field->value()));
    return found;
}

/// Returns the answer to a request that could not be read; nothing if the connection ended.
std::optional<HttpReply> unreadable_request(const SystemError& error,
                                            const protocol::Limits& limits) {
    if (error == http::error::header_limit || error == http::error::buffer_overflow)
        return refuse_request(431, "the header is over http_header_bytes_max = " +
                                       std::to_string(limits.http_header_bytes_max) + " bytes");
    if (error == http::error::end_of_stream || error == http::error::partial_message ||
        error.category() != make_error_code(http::error::bad_target).category())
        return std::nullopt;
    return refuse_request(400, "this is not a request of HTTP/1.1: " + error.message());
}

PeerIdentity over_http(PeerIdentity peer, bool is_encrypted) {
    peer.transport = is_encrypted ? "https" : "http";
    return peer;
}

HttpStream to_stream(Socket socket, const TlsContext* tls) {
    if (tls == nullptr) return HttpStream(std::move(socket));
    return HttpStream(std::make_unique<TlsSocket>(std::move(socket), *tls));
}

}  // namespace

PageResponse to_response(const HttpReply& reply, unsigned version, bool only_header) {
    PageResponse response{http::int_to_status(reply.status), version};
    response.set(http::field::server, "raynestd/" RAYNEST_VERSION);
    response.set("Content-Security-Policy",
                 "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: "
                 "data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
                 "frame-ancestors 'none'");
    response.set("X-Content-Type-Options", "nosniff");
    response.set("Referrer-Policy", "no-referrer");
    response.set("Cross-Origin-Resource-Policy", "same-origin");
    response.set(http::field::cache_control, reply.etag.empty() ? "no-store" : "no-cache");
    if (!reply.etag.empty()) response.set(http::field::etag, reply.etag);
    if (!reply.cookie.empty()) response.set(http::field::set_cookie, reply.cookie);
    if (reply.retry_after_s != 0)
        response.set(http::field::retry_after, std::to_string(reply.retry_after_s));
    if (reply.status == 405) response.set(http::field::allow, view(reply.allow));
    if (reply.status == 401) response.set(http::field::www_authenticate, "Bearer");
    if (reply.status == 426) response.set(http::field::upgrade, "websocket");
    if (reply.status == 304) return response;
    const std::string_view body = reply.body();
    response.set(http::field::content_type, view(reply.type));
    response.content_length(body.size());
    if (!only_header) response.body() = body;
    return response;
}

HttpReply refuse_request(unsigned status, std::string why) {
    HttpReply reply;
    reply.status = status;
    reply.text = std::move(why) + '\n';
    return reply;
}

/// One HTTP connection: reads a request, answers it, and so on. A time limit covers each of the
/// two, and another the handshake of TLS and the first request together.
class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
public:
    HttpConnection(HttpServer& server, Socket socket, Descriptors descriptors,
                   const TlsContext* tls)
        : server_(server),
          descriptors_(descriptors),
          limits_(server.limits_),
          metrics_(server.metrics_),
          names_(tls == nullptr ? std::vector<std::string>() : tls->names()),
          address_(remote_address(socket).value_or(asio::ip::address())),
          peer_(over_http(identity_of(socket), tls != nullptr)),
          stream_(to_stream(std::move(socket), tls)),
          timer_(server.io_),
          buffer_(limits_.http_header_bytes_max + 1) {
        protocol::tune_tcp(stream_.socket().native_handle());
        stream_.pays(peer_.name);
    }

    /// Begins to serve, as the last of a list.
    void start(HttpServer::List& list) {
        list_ = &list;
        place_ = list.insert(list.end(), shared_from_this());
        try {
            asio::co_spawn(server_.io_, serve(),
                           [self = shared_from_this()](const std::exception_ptr& failure) {
                               self->stop();
                               if (failure) std::rethrow_exception(failure);
                           });
        } catch (const std::bad_alloc&) {
            stop();
            throw;
        }
    }
    /// Closes the connection, and leaves its list.
    void stop() {
        timer_.cancel();
        stream_.close();
        if (list_ != nullptr) std::exchange(list_, nullptr)->erase(place_);
    }
    void move_to(HttpServer::List& list) {
        list.splice(list.end(), *std::exchange(list_, &list), place_);
    }
    /// True if it was answered, and waits for a request of which nothing has come.
    [[nodiscard]] bool is_idle() const { return idle_ && !is_stranger(); }
    [[nodiscard]] const std::string& address() const { return peer_.name; }
    [[nodiscard]] Descriptors descriptors() const { return descriptors_; }

private:
    using Parser = http::request_parser<http::string_body>;

    asio::awaitable<void> serve();
    asio::awaitable<void> shake_hands(SystemError& error);
    void log_failed_handshake(const std::string& why);
    asio::awaitable<void> read_header(Parser& parser, SystemError& error);
    /// Returns what the site is asked. The views are valid as long as `request`.
    [[nodiscard]] HttpRequest to_asked(const PageRequest& request, bool has_body) const;
    void become_websocket(PageRequest request, PeerIdentity peer);
    asio::awaitable<void> write(const HttpReply& reply, unsigned version, bool only_header,
                                bool keep_alive, SystemError& error);
    asio::awaitable<void> linger();
    /// True until its first request has come.
    [[nodiscard]] bool is_stranger() const { return list_ == &server_.strangers_; }
    /// Ends the connection after this time, and counts that unless it is only the end of a wait.
    void limit_time(milliseconds time, bool is_counted = true);
    void count(const HttpReply& reply);

    HttpServer& server_;
    const Descriptors descriptors_;
    const protocol::Limits& limits_;
    Metrics& metrics_;
    const std::vector<std::string> names_;  ///< the certificate's
    const asio::ip::address address_;
    PeerIdentity peer_;
    HttpServer::List* list_ = nullptr;  ///< null: stopped
    HttpServer::List::iterator place_;
    HttpStream stream_;
    asio::steady_timer timer_;
    beast::flat_buffer buffer_;
    bool idle_ = true;
};

void HttpConnection::log_failed_handshake(const std::string& why) {
    ++metrics_.handshakes_failed;
    log_limited(LogLevel::info, "handshake_failed", peer_.name,
                {{"peer", peer_.whereabouts()}, {"reason", why}});
}

asio::awaitable<void> HttpConnection::shake_hands(SystemError& error) {
    TlsSocket& tls = *stream_.tls();
    if (co_await tls.starts_plain(error)) {
        log_failed_handshake("it does not speak TLS");
        SystemError ignored;
        http::write(tls.socket(),
                    to_response(refuse_request(400,
                                               "this port is encrypted: open it with "
                                               "https:// in place of http://"),
                                11, false),
                    ignored);
        co_await tls.linger();
        error = asio::error::connection_aborted;
    }
    if (error) co_return;
    std::string why;
    co_await tls.accept(error, why, peer_.name);
    if (!why.empty()) log_failed_handshake(why);
    if (!error) tls.tell_subject(peer_);
}

asio::awaitable<void> HttpConnection::read_header(Parser& parser, SystemError& error) {
    parser.header_limit(static_cast<std::uint32_t>(limits_.http_header_bytes_max));
    // Bodies are read only where the site wants them, and to their limit.
    parser.body_limit(std::numeric_limits<std::uint64_t>::max());
    if (!is_stranger()) limit_time(milliseconds(limits_.http_ms_max));
    idle_ = buffer_.size() == 0 && !stream_.has_bytes();
    if (idle_)
        co_await stream_.socket().async_wait(Socket::wait_read,
                                             asio::redirect_error(asio::use_awaitable, error));
    idle_ = false;
    co_await http::async_read_header(stream_, buffer_, parser,
                                     asio::redirect_error(asio::use_awaitable, error));
}

HttpRequest HttpConnection::to_asked(const PageRequest& request, bool has_body) const {
    HttpRequest asked{view(request.method_string()),
                      view(request.target()),
                      values(request, http::field::host),
                      values(request, http::field::origin),
                      view(request[http::field::if_none_match]),
                      beast::websocket::is_upgrade(request),
                      has_body,
                      view(request[http::field::authorization])};
    asked.cookies = values(request, http::field::cookie);
    asked.body = request.body();
    asked.version = request.version();
    asked.certificate_names = names_;
    asked.forwarded.any = std::ranges::any_of(
        request, [](const auto& field) { return is_from_proxies(view(field.name_string())); });
    asked.forwarded.sender = values(request, "X-Forwarded-For");
    asked.forwarded.scheme = values(request, "X-Forwarded-Proto");
    asked.forwarded.host = values(request, "X-Forwarded-Host");
    asked.sender = peer_;
    asked.is_encrypted = peer_.transport == "https";
    find_sender(asked, address_, server_.proxies_);
    return asked;
}

void HttpConnection::become_websocket(PageRequest request, PeerIdentity peer) {
    timer_.cancel();
    auto transport =
        make_websocket(std::move(stream_), std::move(peer), std::move(request), limits_);
    server_.accept_(std::move(transport), descriptors_);
}

asio::awaitable<void> HttpConnection::serve() {
    SystemError error;
    limit_time(milliseconds(std::min(limits_.greeting_ms_max, limits_.http_ms_max)));
    if (stream_.tls() != nullptr) co_await shake_hands(error);
    if (error) co_return;
    bool keep_alive = true;
    while (keep_alive) {
        Parser parser;
        co_await read_header(parser, error);
        if (!error && is_stranger()) {
            server_.admit(*this);
            limit_time(milliseconds(limits_.http_ms_max));
        }
        // With a transfer coding a proxy might see the end of the request elsewhere: close
        // afterwards.
        const bool is_coded = parser.get().count(http::field::transfer_encoding) != 0;
        if (!error && !parser.is_done() && !is_coded) {
            const HttpRequest asked = to_asked(parser.get(), true);
            const auto length = parser.content_length();
            if (server_.site_.takes_body(asked) && length && *length <= body_bytes_max) {
                if (beast::iequals(parser.get()[http::field::expect], "100-continue")) {
                    http::response<http::empty_body> go_on(http::status::continue_, 11);
                    co_await http::async_write(stream_, go_on,
                                               asio::redirect_error(asio::use_awaitable, error));
                }
                co_await http::async_read(stream_, buffer_, parser,
                                          asio::redirect_error(asio::use_awaitable, error));
            }
        }
        if (error) {
            const auto reply = unreadable_request(error, limits_);
            if (!reply) co_return;
            count(*reply);
            co_await write(*reply, 11, false, false, error);
            break;
        }
        const HttpRequest asked = to_asked(parser.get(), is_coded || !parser.is_done());
        Turns& turns = Turns::of(stream_.socket());
        if (turns.is_over(asked.sender.name)) co_await turns.wait(asked.sender.name);
        if (!stream_.socket().is_open()) co_return;
        const auto began = Turns::Clock::now();
        const HttpReply reply = server_.site_.answer(asked);
        turns.spend(asked.sender.name, Turns::Clock::now() - began);
        count(reply);
        if (reply.status == 101) {
            PeerIdentity peer = asked.sender;
            peer.sender = reply.sender;
            become_websocket(parser.release(), std::move(peer));
            co_return;
        }
        // Another program might read a malformed request as several ones.
        const bool is_malformed = reply.status == 400;
        keep_alive = parser.get().keep_alive() && !asked.has_body && !is_malformed;
        co_await write(reply, parser.get().version(), asked.method == "HEAD", keep_alive, error);
        if (error) co_return;
    }
    co_await linger();
}

asio::awaitable<void> HttpConnection::write(const HttpReply& reply, unsigned version,
                                            bool only_header, bool keep_alive, SystemError& error) {
    PageResponse response = to_response(reply, version, only_header);
    response.keep_alive(keep_alive);
    error = {};
    limit_time(milliseconds(limits_.http_ms_max));
    co_await http::async_write(stream_, response, asio::redirect_error(asio::use_awaitable, error));
}

asio::awaitable<void> HttpConnection::linger() {
    // Closing with unread bytes would reset the connection, and the client could lose the answer.
    limit_time(linger_time, false);
    stream_.finish_writing();
    SystemError error;
    std::array<char, 4096> skipped;
    while (!error)
        co_await stream_.socket().async_read_some(asio::buffer(skipped),
                                                  asio::redirect_error(asio::use_awaitable, error));
}

void HttpConnection::limit_time(milliseconds time, bool is_counted) {
    timer_.expires_after(time);
    timer_.async_wait([self = shared_from_this(), is_counted](const SystemError& cancelled) {
        if (cancelled || !self->stream_.socket().is_open()) return;
        if (is_counted && !self->is_idle()) ++self->metrics_.http_timeouts;
        self->stop();
    });
}

void HttpConnection::count(const HttpReply& reply) {
    IoTurn::does("HTTP request");
    ++metrics_.http_requests;
    if (reply.status >= 400) ++metrics_.http_refused;
    if (reply.foreign == Foreign::host) ++metrics_.http_foreign_hosts;
    if (reply.foreign == Foreign::origin) ++metrics_.http_foreign_origins;
}

void HttpServer::end_one(const List& list, Metrics::Counter& counter) {
    std::map<std::string_view, std::size_t> by_address;
    std::size_t most = 0;
    for (const auto& connection : list) most = std::max(most, ++by_address[connection->address()]);
    const auto is_of_most = [&](const auto& connection) {
        return by_address[connection->address()] == most;
    };
    auto victim = std::ranges::find_if(list, [&](const auto& connection) {
        return connection->is_idle() && is_of_most(connection);
    });
    if (victim == list.end()) victim = std::ranges::find_if(list, is_of_most);
    ++counter;
    const auto connection = *victim;
    connection->stop();
}

void HttpServer::admit(HttpConnection& connection) {
    connection.move_to(open_);
    if (open_.size() > limits_.http_connections_max) end_one(open_, metrics_.gave_way_connections);
}

void HttpServer::make_reserved_room() {
    // Strangers first, then those that wait for a request: the first of these gives way.
    std::vector<std::shared_ptr<HttpConnection>> reserved;
    for (const List* list : {&strangers_, &open_})
        std::ranges::copy_if(*list, std::back_inserter(reserved), [](const auto& connection) {
            return connection->descriptors() == Descriptors::reserved;
        });
    if (reserved.size() < reserved_places) return;
    auto victim = std::ranges::find_if(reserved, [](const auto& c) { return c->is_idle(); });
    if (victim == reserved.end()) victim = reserved.begin();
    (*victim)->stop();
}

void HttpServer::accept(Socket socket, Descriptors descriptors, const TlsContext* tls) {
    SystemError ignored;
    socket.non_blocking(true, ignored);
    if (descriptors == Descriptors::reserved) make_reserved_room();
    if (descriptors == Descriptors::used_up) {
        ++metrics_.http_connections_refused;
        // A handshake would take a place.
        if (tls == nullptr)
            http::write(
                socket,
                to_response(refuse_request(503, "the daemon has no free HTTP connections: its " +
                                                    descriptors_text()),
                            11, false),
                ignored);
        return;
    }
    std::make_shared<HttpConnection>(*this, std::move(socket), descriptors, tls)->start(strangers_);
    if (strangers_.size() > limits_.greeting_connections_max)
        end_one(strangers_, metrics_.greetings_gave_way);
}

}  // namespace raynest::server
