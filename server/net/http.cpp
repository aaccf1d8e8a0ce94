#include "server/net/http.h"

#include "protocol/keep_alive.h"
#include "server/net/socket_transport.h"
#include "server/net/websocket_messages.h"

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/version.hpp>
#include <boost/beast/websocket.hpp>
#include <linux/sockios.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <limits>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using std::chrono::milliseconds;

using PageRequest = http::request<http::empty_body>;
using PageResponse = http::response<http::string_body>;

/// Time for a client to read the last answer and to close.
constexpr milliseconds linger_time{1000};

std::string_view view(beast::string_view text) {
    return {text.data(), text.size()};
}

std::vector<std::string_view> values(const PageRequest& request, http::field name) {
    std::vector<std::string_view> found;
    const auto [first, last] = request.equal_range(name);
    for (auto field = first; field != last; ++field) found.push_back(view(field->value()));
    return found;
}

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
    if (reply.status == 405) response.set(http::field::allow, "GET, HEAD");
    if (reply.status == 401) response.set(http::field::www_authenticate, "Bearer");
    if (reply.status == 426) response.set(http::field::upgrade, "websocket");
    if (reply.status == 304) return response;
    const std::string_view body = reply.body();
    response.set(http::field::content_type,
                 beast::string_view(reply.type.data(), reply.type.size()));
    response.content_length(body.size());
    if (!only_header) response.body() = body;
    return response;
}

HttpReply refused(unsigned status, std::string why) {
    HttpReply reply;
    reply.status = status;
    reply.text = std::move(why) + '\n';
    return reply;
}

/// Returns the answer to a request that could not be read; nothing if the connection ended.
std::optional<HttpReply> unreadable_request(const SystemError& error,
                                            const protocol::Limits& limits) {
    if (error == http::error::header_limit || error == http::error::buffer_overflow)
        return refused(431, "the header is over http_header_bytes_max = " +
                                std::to_string(limits.http_header_bytes_max) + " bytes");
    if (error == http::error::end_of_stream || error == http::error::partial_message ||
        error.category() != make_error_code(http::error::bad_target).category())
        return std::nullopt;
    return refused(400, "this is not a request of HTTP/1.1: " + error.message());
}

// ---- WebSocket ----------------------------------------------------------------------------------

PeerIdentity over_http(PeerIdentity peer) {
    peer.transport = "http";
    return peer;
}

/// A WebSocket that carries frames as websocket_messages.h says: each message is one frame.
class WebSocketTransport final : public Transport {
public:
    WebSocketTransport(Socket socket, PageRequest request, const protocol::Limits& limits)
        : limits_(limits),
          peer_(over_http(identity_of(socket))),
          request_(std::move(request)),
          stream_(std::move(socket)) {
        stream_.auto_fragment(false);
        stream_.read_message_max(limits.frame_bytes_max);
        stream_.set_option(websocket::stream_base::decorator([](websocket::response_type& made) {
            made.set(http::field::server, "raynestd/" RAYNEST_VERSION);
        }));
    }

    [[nodiscard]] const PeerIdentity& peer() const override { return peer_; }

    asio::awaitable<void> open(SystemError& error) override {
        co_await stream_.async_accept(request_, asio::redirect_error(asio::use_awaitable, error));
        opened_ = !error;
    }
    asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t wanted,
                                      SystemError& error) override;
    std::optional<Unreadable> take_unreadable() override {
        return std::exchange(unreadable_, std::nullopt);
    }
    asio::awaitable<std::size_t> write(const WriteBatch::Rest& rest, SystemError& error) override;
    std::size_t write_now(const WriteBatch::Rest& rest) override;
    asio::awaitable<void> finish_writing() override {
        SystemError ignored;
        co_await stream_.async_close(websocket::close_code::normal,
                                     asio::redirect_error(asio::use_awaitable, ignored));
    }
    void close() override {
        SystemError ignored;
        stream_.next_layer().close(ignored);
    }
    bool is_lost() override { return peer_is_lost(stream_.next_layer().native_handle()); }

private:
    /// The next frame of a batch as a message.
    struct Outgoing {
        bool is_text = false;
        std::string head;
        asio::const_buffer bulk;
        std::size_t frame_bytes = 0;

        [[nodiscard]] std::array<asio::const_buffer, 2> buffers() const {
            return {asio::buffer(head), bulk};
        }
    };
    [[nodiscard]] Outgoing next_message(const WriteBatch::Rest& rest) const;
    void refuse_upgrade(const WriteBatch::Rest& rest);

    /// Reads the next message up to its bulk part, and converts it.
    asio::awaitable<void> read_message(SystemError& error);
    /// Appends to `message_` until it has `bytes` bytes or the WebSocket message ends.
    asio::awaitable<void> gather(std::size_t bytes, SystemError& error);
    asio::awaitable<void> skip_message(SystemError& error);
    void refuse(Unreadable unreadable) {
        unreadable_ = std::move(unreadable);
        message_.clear();
    }
    void refuse(Code code, std::string why) { refuse({0, 0, {code, std::move(why), 0}, true}); }
    /// Makes the frame the next bytes that read() returns.
    void convert(Read<protocol::Frame> frame);

    const protocol::Limits& limits_;
    const PeerIdentity peer_;
    const PageRequest request_;
    websocket::stream<Socket, false> stream_;
    MessageConverter converter_;
    std::string message_;  ///< received bytes of a message
    std::string frame_;    ///< header and control message of the frame that read() returns
    std::size_t frame_sent_ = 0;
    std::uint64_t bulk_left_ = 0;  ///< bytes of the bulk part that were not read yet
    std::optional<Unreadable> unreadable_;
    bool opened_ = false;
    bool in_message_ = false;  ///< a message has begun and not ended
    bool greeted_ = false;     ///< the first message has come
};

asio::awaitable<std::size_t> WebSocketTransport::read(const ReadBuffers& buffers,
                                                      std::size_t /*wanted*/, SystemError& error) {
    if (frame_sent_ == frame_.size() && bulk_left_ == 0) co_await read_message(error);
    if (error || unreadable_) co_return 0;
    if (frame_sent_ < frame_.size()) {
        const std::size_t bytes = asio::buffer_copy(buffers, asio::buffer(frame_) + frame_sent_);
        frame_sent_ += bytes;
        co_return bytes;
    }
    const std::size_t bytes =
        co_await stream_.async_read_some(buffers, asio::redirect_error(asio::use_awaitable, error));
    if (error) co_return 0;
    in_message_ = !stream_.is_message_done();
    const bool ended_early = bytes < bulk_left_ && !in_message_;
    const bool goes_on = bytes > bulk_left_ || (bytes == bulk_left_ && in_message_);
    if (ended_early || goes_on) {
        bulk_left_ = 0;
        refuse(Code::bad_frame, "a message holds more or fewer bytes than its header says");
        co_return 0;
    }
    bulk_left_ -= bytes;
    co_return bytes;
}

asio::awaitable<void> WebSocketTransport::read_message(SystemError& error) {
    if (in_message_) co_await skip_message(error);
    if (error) co_return;
    const std::uint64_t most = greeted_ ? limits_.control_bytes_max : limits_.greeting_bytes_max;
    constexpr std::size_t prefix_bytes_max = 64;  // TYPE and ID of a text message
    message_.clear();
    in_message_ = true;
    co_await gather(protocol::header_bytes, error);
    if (error) co_return;
    if (stream_.got_text()) {
        co_await gather(prefix_bytes_max + most + 1, error);
        if (error) co_return;
        if (message_.size() > prefix_bytes_max + most)
            co_return refuse(Code::limit_exceeded,
                             std::string("a text message is over ") +
                                 (greeted_ ? "control_bytes_max" : "greeting_bytes_max") + " = " +
                                 std::to_string(most) + " bytes");
        co_return convert(converter_.read_text(message_));
    }
    if (message_.size() < protocol::header_bytes)
        co_return refuse(Code::bad_frame, "a binary message begins with a header of 32 bytes");
    const auto header = protocol::read_header(
        std::span<const std::byte, protocol::header_bytes>(
            reinterpret_cast<const std::byte*>(message_.data()), protocol::header_bytes),
        limits_);
    if (!header) co_return refuse({0, 0, header.error(), true});
    if (header->control_bytes > most)
        co_return refuse(Code::limit_exceeded, "the first message is over greeting_bytes_max = " +
                                                   std::to_string(most) + " bytes");
    const std::size_t head_bytes = protocol::header_bytes + header->control_bytes;
    co_await gather(head_bytes, error);
    if (error) co_return;
    if (message_.size() < head_bytes || in_message_ != (header->bulk_bytes != 0))
        co_return refuse(Code::bad_frame,
                         "a message holds more or fewer bytes than its header says");
    bulk_left_ = header->bulk_bytes;
    convert(
        converter_.read_binary(*header, std::string_view(message_).substr(protocol::header_bytes)));
}

asio::awaitable<void> WebSocketTransport::gather(std::size_t bytes, SystemError& error) {
    constexpr std::size_t step = 4096;
    while (in_message_ && message_.size() < bytes) {
        const std::size_t before = message_.size();
        message_.resize(std::min(bytes, before + step));
        const std::size_t got = co_await stream_.async_read_some(
            asio::buffer(message_.data() + before, message_.size() - before),
            asio::redirect_error(asio::use_awaitable, error));
        message_.resize(before + got);
        in_message_ = !error && !stream_.is_message_done();
    }
}

asio::awaitable<void> WebSocketTransport::skip_message(SystemError& error) {
    std::array<char, 4096> skipped;
    while (in_message_ && !error) {
        co_await stream_.async_read_some(asio::buffer(skipped),
                                         asio::redirect_error(asio::use_awaitable, error));
        in_message_ = !stream_.is_message_done();
    }
}

void WebSocketTransport::convert(Read<protocol::Frame> frame) {
    greeted_ = true;
    if (!frame) {
        bulk_left_ = 0;
        return refuse(std::move(frame.error()));
    }
    frame_.resize(protocol::header_bytes);
    frame_sent_ = 0;
    protocol::write_header(
        frame->header, std::span<std::byte, protocol::header_bytes>(
                           reinterpret_cast<std::byte*>(frame_.data()), protocol::header_bytes));
    frame_.append(reinterpret_cast<const char*>(frame->control.data()), frame->control.size());
}

WebSocketTransport::Outgoing WebSocketTransport::next_message(const WriteBatch::Rest& rest) const {
    // A batch has header, control message and bulk part of a frame in buffers of their own, and
    // this transport sends whole frames only.
    const asio::const_buffer* part = rest.begin();
    const auto bytes_of = [](const asio::const_buffer& buffer) {
        return std::span(static_cast<const std::byte*>(buffer.data()), buffer.size());
    };
    const auto header =
        protocol::read_header(bytes_of(*part).first<protocol::header_bytes>(), limits_);
    Outgoing made;
    made.is_text = header->block_count == 0;
    made.head = converter_.write(*header, bytes_of(*++part));
    if (header->bulk_bytes != 0) made.bulk = *++part;
    made.frame_bytes = header->frame_bytes();
    return made;
}

asio::awaitable<std::size_t> WebSocketTransport::write(const WriteBatch::Rest& rest,
                                                       SystemError& error) {
    const Outgoing message = next_message(rest);
    stream_.text(message.is_text);
    co_await stream_.async_write(message.buffers(),
                                 asio::redirect_error(asio::use_awaitable, error));
    co_return error ? 0 : message.frame_bytes;
}

std::size_t WebSocketTransport::write_now(const WriteBatch::Rest& rest) {
    // An empty send buffer takes a small message whole.
    constexpr std::size_t small_bytes_max = 2048;
    if (rest.begin() == rest.end()) return 0;
    if (!opened_) {
        refuse_upgrade(rest);
        return 0;
    }
    int waiting = 0;
    if (ioctl(stream_.next_layer().native_handle(), SIOCOUTQ, &waiting) != 0 || waiting != 0)
        return 0;
    const Outgoing message = next_message(rest);
    if (message.head.size() + message.bulk.size() > small_bytes_max) return 0;
    SystemError error;
    stream_.text(message.is_text);
    stream_.write(message.buffers(), error);
    if (error) close();
    return error ? 0 : message.frame_bytes;
}

void WebSocketTransport::refuse_upgrade(const WriteBatch::Rest& rest) {
    // The frame is Error: its text is the answer.
    const asio::const_buffer& control = *(rest.begin() + 1);
    const auto* error = flatbuffers::GetRoot<wire::Error>(control.data());
    const std::string why(protocol::text(error->message()));
    SystemError ignored;
    http::write(stream_.next_layer(), to_response(refused(503, why), request_.version(), false),
                ignored);
}

}  // namespace

// ---- HTTP ---------------------------------------------------------------------------------------

/// One HTTP connection: reads a request, answers it, and so on. A time limit covers each of the
/// two.
class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
public:
    HttpConnection(HttpServer& server, Socket socket)
        : server_(server),
          limits_(server.services_.limits),
          metrics_(server.services_.metrics),
          socket_(std::move(socket)),
          timer_(server.io_),
          buffer_(limits_.http_header_bytes_max + 1) {
        protocol::tune_tcp(socket_.native_handle());
    }

    void start(HttpServer::List::iterator place) {
        place_ = place;
        asio::co_spawn(server_.io_, serve(),
                       [self = shared_from_this()](const std::exception_ptr& failure) {
                           self->stop();
                           self->server_.open_.erase(self->place_);
                           if (failure) std::rethrow_exception(failure);
                       });
    }
    void stop() {
        SystemError ignored;
        idle_ = false;
        timer_.cancel();
        socket_.close(ignored);
    }
    /// True if it waits for a request of which nothing has come.
    [[nodiscard]] bool is_idle() const { return idle_; }

private:
    asio::awaitable<void> serve();
    asio::awaitable<void> write(const HttpReply& reply, unsigned version, bool only_header,
                                bool keep_alive, SystemError& error);
    asio::awaitable<void> linger();
    void limit_time(milliseconds time);
    void count(const HttpReply& reply);

    HttpServer& server_;
    const protocol::Limits& limits_;
    Metrics& metrics_;
    HttpServer::List::iterator place_;
    Socket socket_;
    asio::steady_timer timer_;
    beast::flat_buffer buffer_;
    bool idle_ = true;
};

asio::awaitable<void> HttpConnection::serve() {
    bool keep_alive = true;
    while (keep_alive) {
        http::request_parser<http::empty_body> parser;
        parser.header_limit(static_cast<std::uint32_t>(limits_.http_header_bytes_max));
        parser.body_limit(std::numeric_limits<std::uint64_t>::max());  // bodies are not read
        limit_time(milliseconds(limits_.http_ms_max));
        SystemError error;
        idle_ = buffer_.size() == 0;
        if (idle_)
            co_await socket_.async_wait(Socket::wait_read,
                                        asio::redirect_error(asio::use_awaitable, error));
        idle_ = false;
        co_await http::async_read_header(socket_, buffer_, parser,
                                         asio::redirect_error(asio::use_awaitable, error));
        if (error) {
            const auto reply = unreadable_request(error, limits_);
            if (!reply) co_return;
            count(*reply);
            co_await write(*reply, 11, false, false, error);
            break;
        }
        const PageRequest& request = parser.get();
        const HttpRequest asked{view(request.method_string()),
                                view(request.target()),
                                values(request, http::field::host),
                                values(request, http::field::origin),
                                view(request[http::field::if_none_match]),
                                websocket::is_upgrade(request),
                                !parser.is_done(),
                                view(request[http::field::authorization])};
        const HttpReply reply = server_.site_.answer(asked);
        count(reply);
        if (reply.status == 101) {
            timer_.cancel();
            auto transport =
                std::make_unique<WebSocketTransport>(std::move(socket_), parser.release(), limits_);
            server_.connections_.accept(std::move(transport), Connections::Descriptors::free);
            co_return;
        }
        keep_alive = request.keep_alive() && !asked.has_body;
        co_await write(reply, request.version(), asked.method == "HEAD", keep_alive, error);
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
    co_await http::async_write(socket_, response, asio::redirect_error(asio::use_awaitable, error));
}

asio::awaitable<void> HttpConnection::linger() {
    // Closing with unread bytes would reset the connection, and the client could lose the answer.
    limit_time(linger_time);
    SystemError error;
    socket_.shutdown(Socket::shutdown_send, error);
    std::array<char, 4096> skipped;
    while (!error)
        co_await socket_.async_read_some(asio::buffer(skipped),
                                         asio::redirect_error(asio::use_awaitable, error));
}

void HttpConnection::limit_time(milliseconds time) {
    timer_.expires_after(time);
    const bool is_linger = time == linger_time;
    timer_.async_wait([self = shared_from_this(), is_linger](const SystemError& cancelled) {
        if (cancelled || !self->socket_.is_open()) return;
        if (!is_linger && !self->idle_) ++self->metrics_.http_timeouts;
        self->stop();
    });
}

void HttpConnection::count(const HttpReply& reply) {
    ++metrics_.http_requests;
    if (reply.status >= 400) ++metrics_.http_refused;
    if (reply.foreign == Foreign::host) ++metrics_.http_foreign_hosts;
    if (reply.foreign == Foreign::origin) ++metrics_.http_foreign_origins;
}

bool HttpServer::make_room() {
    if (open_.size() < services_.limits.http_connections_max) return true;
    const auto idle =
        std::ranges::find_if(open_, [](const auto& connection) { return connection->is_idle(); });
    if (idle == open_.end()) return false;
    (*idle)->stop();
    return true;
}

void HttpServer::accept(Socket socket, Connections::Descriptors descriptors) {
    SystemError ignored;
    socket.non_blocking(true, ignored);
    if (descriptors == Connections::Descriptors::used_up || !make_room()) {
        ++services_.metrics.http_connections_refused;
        http::write(socket,
                    to_response(refused(503,
                                        "the daemon has no free HTTP connections; try again, or "
                                        "raise --http-connections-max"),
                                11, false),
                    ignored);
        return;
    }
    const auto place =
        open_.insert(open_.end(), std::make_shared<HttpConnection>(*this, std::move(socket)));
    (*place)->start(place);
}

}  // namespace raynest::server
