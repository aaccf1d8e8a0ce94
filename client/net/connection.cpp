#include "client/net/connection.h"

#include "client/ground/interrupt.h"
#include "client/net/address.h"
#include "client/net/tls.h"
#include "protocol/keep_alive.h"
#include "protocol/request_id.h"

#include <boost/asio/buffer.hpp>
#include <boost/asio/generic/stream_protocol.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/local/stream_protocol.hpp>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <utility>  // before Asio: Boost 1.74 needs std::exchange in C++20
#include <vector>

namespace raynest::client {

namespace asio = boost::asio;
using boost::system::error_code;
using protocol::Frame;
using Clock = std::chrono::steady_clock;

namespace {

constexpr std::chrono::seconds greeting_time{5};
/// The daemon answers DEADLINE itself; beyond this the connection is taken for dead.
constexpr std::chrono::seconds grace{5};
/// Longest wait between two checks for Ctrl-C and the deadline.
constexpr int look_ms = 200;
/// Time between two attempts to connect to a Unix socket whose queue is full.
constexpr int call_again_ms = 20;
/// Explains a connection that closed in the middle of an answer, where no ERROR fits.
constexpr const char* cut_short =
    " within an answer: the daemon ended, or this reader paused and gave way to another client";
/// Buffer for headers and control parts.
constexpr std::size_t staging_bytes = 4 << 10;
constexpr std::size_t tls_record_bytes = 16 << 10;

/// Connects a non-blocking socket until `end` or a Ctrl-C.
error_code connect_until(int socket, const asio::generic::stream_protocol::endpoint& endpoint,
                         Clock::time_point end) {
    while (true) {
        const auto size = static_cast<socklen_t>(endpoint.size());
        if (::connect(socket, endpoint.data(), size) == 0 || errno == EISCONN) return {};
        // A Unix socket gives EAGAIN while its queue of callers is full, and poll() does not tell
        // when that has changed.
        const bool full = errno == EAGAIN;
        if (!full && errno != EINPROGRESS && errno != EALREADY && errno != EINTR)
            return {errno, boost::system::system_category()};
        if (interrupted()) return asio::error::operation_aborted;
        if (Clock::now() >= end) return asio::error::timed_out;
        pollfd waiting{socket, POLLOUT, 0};
        (void)::poll(&waiting, full ? 0 : 1, full ? call_again_ms : look_ms);
    }
}

bool is_forbidden(const error_code& error) {
    return error == boost::system::errc::permission_denied ||
           error == boost::system::errc::operation_not_permitted;
}

/// Says how to start or reach a daemon at `uri` after a failed connect.
std::string start_hint(const std::string& uri, const error_code& error) {
    const bool is_unix = uri.starts_with("unix:");
    if (is_unix && is_forbidden(error))
        return "you may not open this socket: join its group, or start raynestd with "
               "--socket-group";
    std::error_code ignored;
    const auto status = std::filesystem::status(is_unix ? uri.substr(5) : "", ignored);
    if (is_unix && std::filesystem::exists(status) && !std::filesystem::is_socket(status))
        return "it is no socket: name the PATH that a daemon was given with --listen unix:PATH";
    if (uri == default_uri) return "start a daemon with: raynestd &";
    return is_this_machine(uri) && !uri.starts_with("tls://")
               ? "start a daemon with: raynestd --listen " + uri + " &"
               : "is raynestd running there?";
}

/// True for a message that more of the same answer follows; every other one ends its request. One of
/// a later version does not.
bool is_continued(std::uint16_t type) {
    static constexpr std::array continued = {
        protocol::message_of<wire::Started>,  protocol::message_of<wire::Chunk>,
        protocol::message_of<wire::Progress>, protocol::message_of<wire::Payload>,
        protocol::message_of<wire::Credit>,   protocol::message_of<wire::Need>};
    return std::ranges::find(continued, static_cast<wire::Message>(type)) != continued.end() ||
           !protocol::message_known(type);
}

/// True for the alert by which a TLS server answers bytes that are not TLS.
bool is_tls_alert(std::span<const std::byte> bytes) {
    return bytes.size() >= 2 && bytes[0] == std::byte{21} && bytes[1] == std::byte{3};
}

/// The failure of a greeting, with exit code 3 unless the daemon names another. Only a connection
/// that ended is `lost`: a server that has answered will not say more the next time.
Failure unanswered(const Failure& why) {
    if (why.exit == Exit::deadline) {
        Failure silent = lost(Exit::cannot_connect, "no RayNest daemon answers within " +
                                                        std::to_string(greeting_time.count()) +
                                                        " s; is it raynestd that listens there?");
        silent.silent = true;
        return silent;
    }
    if (why.exit != Exit::failed) return why;
    Failure unanswered = failure(Exit::cannot_connect, "no RayNest daemon answers: " + why.message);
    unanswered.lost = why.lost;
    return unanswered;
}

}  // namespace

struct Connection::Socket {
    asio::io_context io;
    asio::generic::stream_protocol::socket stream{io};
    std::unique_ptr<TlsStream> tls;  ///< null: not encrypted

    /// Writes a part of the buffers; would_block if none fits now.
    template <std::size_t n>
    std::size_t write_some(const std::array<asio::const_buffer, n>& parts, error_code& error) {
        if (!tls) return stream.write_some(parts, error);
        const auto first = std::ranges::find_if(
            parts, [](const asio::const_buffer& part) { return part.size() != 0; });
        const bool is_large = first != parts.end() && first->size() >= tls_record_bytes;
        // Small parts share a record; OpenSSL encrypts into a buffer of its own in any case.
        std::array<std::byte, tls_record_bytes> record;
        const std::size_t size =
            is_large ? first->size() : asio::buffer_copy(asio::buffer(record), parts);
        const auto* bytes = is_large ? static_cast<const std::byte*>(first->data()) : record.data();
        const auto moved = tls->write({bytes, size});
        // The next call repeats an error.
        error = moved.bytes == 0 ? error_of(moved.state) : error_code();
        if (!error && !tls->is_flushed()) error = asio::error::would_block;
        return moved.bytes;
    }
    [[nodiscard]] bool is_flushed() const { return !tls || tls->is_flushed(); }
    /// Fills the buffers in order with what is there; would_block if nothing is.
    std::size_t read_some(const std::array<asio::mutable_buffer, 2>& parts, error_code& error) {
        if (!tls) return stream.receive(parts, 0, error);
        std::size_t bytes = 0;
        for (const asio::mutable_buffer& part : parts) {
            const auto moved = tls->read({static_cast<std::byte*>(part.data()), part.size()});
            bytes += moved.bytes;
            // The next call repeats an error.
            error = bytes == 0 ? error_of(moved.state) : error_code();
            if (moved.state != TlsStream::State::ready) break;
        }
        return bytes;
    }
    static error_code error_of(TlsStream::State state) {
        switch (state) {
            case TlsStream::State::ready:
                return {};
            case TlsStream::State::wait:
                return asio::error::would_block;
            case TlsStream::State::ended:
                return asio::error::eof;
            case TlsStream::State::broken:
                return asio::error::connection_reset;
        }
        return {};
    }

    /// Connects to the first endpoint that answers; each gets a share of the time until `end`.
    template <class Endpoints>
    error_code connect(const Endpoints& endpoints, Clock::time_point end) {
        error_code error = asio::error::host_not_found;
        std::ptrdiff_t left = std::ssize(endpoints);
        for (const auto& endpoint : endpoints) {
            const Clock::time_point now = Clock::now();
            const Clock::time_point turn = now + (end - now) / left--;
            stream.close(error);
            const asio::generic::stream_protocol::endpoint generic(endpoint);
            stream.open(generic.protocol(), error);
            if (error) continue;
            stream.non_blocking(true);
            error = connect_until(stream.native_handle(), generic, turn);
            if (!error || error == asio::error::operation_aborted) return error;
        }
        return error;
    }

    error_code connect_tcp(const std::string& host, const std::string& port,
                           Clock::time_point end) {
        error_code error;
        asio::ip::tcp::resolver resolver(io);
        const auto found = resolver.resolve(host, port, error);
        if (error) return error;
        std::vector<asio::ip::tcp::endpoint> endpoints;
        for (const auto& entry : found) endpoints.push_back(entry.endpoint());
        error = connect(endpoints, end);
        if (error) return error;
        protocol::tune_tcp(stream.native_handle());
        return error;
    }
};

Connection::Connection(std::unique_ptr<Socket> socket)
    : socket_(std::move(socket)),
      staging_(new std::byte[staging_bytes]) {}

Connection::~Connection() = default;

Result<std::unique_ptr<Connection>> Connection::open(const std::string& uri, const Access& access) {
    const Clock::time_point end = Clock::now() + greeting_time;
    auto socket = std::make_unique<Socket>();
    error_code error;
    const bool is_tls = uri.starts_with("tls://");
    std::string host;
    try {
        if (is_tls || uri.starts_with("tcp://")) {
            const auto authority = authority_of(uri);
            if (!authority)
                return fail(Exit::usage, "'" + uri + "' is not " + uri.substr(0, 6) +
                                             "HOST:PORT with a port from 1 to 65535");
            host = authority->host;
            error = socket->connect_tcp(host, authority->port, end);
        } else if (uri.rfind("unix:", 0) == 0 && uri != "unix:") {
            const std::array endpoints = {asio::local::stream_protocol::endpoint(uri.substr(5))};
            error = socket->connect(endpoints, end);
        } else {
            return fail(
                Exit::usage,
                "'" + uri + "' is no server: use tcp://HOST:PORT, tls://HOST:PORT, ssh://HOST or " +
                    "unix:PATH" + (uri.starts_with('/') ? "; did you mean unix:" + uri + "?" : ""));
        }
    } catch (const boost::system::system_error& thrown) {  // a path too long for a socket
        error = thrown.code();
    }
    if (error == asio::error::operation_aborted) return fail(Exit::interrupted, "interrupted");
    if (error)
        return fail(
            is_forbidden(error) ? Exit::not_allowed : Exit::cannot_connect,
            "cannot connect to " + uri + ": " + error.message() + "; " + start_hint(uri, error));

    // The name of localhost may lead elsewhere.
    if (uri.starts_with("tcp://") && !access.token.empty() &&
        !is_loopback(*socket->stream.remote_endpoint(error).data()))
        return not_secret(uri);

    std::unique_ptr<Connection> connection(new Connection(std::move(socket)));
    connection->patience_ = end - Clock::now();
    if (is_tls)
        if (auto encrypted = connection->encrypt(host, access.tls); !encrypted)
            return tl::unexpected<Failure>(unanswered(encrypted.error()));
    if (auto greeted = connection->greet(access.token); !greeted) {
        if (!is_tls && is_tls_alert({connection->staging_.get(), connection->staged_end_}))
            return fail(Exit::cannot_connect,
                        "this port is encrypted: connect to it with tls:// in place of tcp://");
        return tl::unexpected<Failure>(unanswered(greeted.error()));
    }
    return connection;
}

Result<void> Connection::encrypt(const std::string& host, const TlsOptions& options) {
    auto stream = TlsStream::open(socket_->stream.native_handle(), host, options,
                                  [this](short events) { return wait(events); });
    if (!stream) return tl::unexpected<Failure>(stream.error());
    socket_->tls = std::move(*stream);
    return {};
}

Result<void> Connection::greet(const std::string& token) {
    wire::HelloT hello;
    hello.version_min = protocol::version_min;
    hello.version_max = protocol::version_max;
    hello.client = "raynest " RAYNEST_VERSION;
    hello.token = token;
    hello.window_bytes = limits_.window_bytes;
    // The daemon logs a refused login under this id.
    id_ = protocol::first_request_id();
    if (auto sent = send(protocol::encode(id_, hello)); !sent) return sent;
    auto frame = next();
    if (!frame) return tl::unexpected<Failure>(frame.error());
    const auto welcome = open_sent<wire::Welcome>(*frame);
    if (!welcome) return tl::unexpected<Failure>(welcome.error());
    daemon_ = {std::string(protocol::text((*welcome)->server())),
               (*welcome)->window_bytes(),
               (*welcome)->frame_bytes_max(),
               (*welcome)->chunk_rays_max(),
               std::string(protocol::text((*welcome)->principal())),
               std::string(protocol::text((*welcome)->role()))};
    // A daemon may be configured to accept less than this client could send, never more.
    daemon_.chunk_rays_max = std::min(daemon_.chunk_rays_max, limits_.chunk_rays_max);
    daemon_.frame_bytes_max = std::min(daemon_.frame_bytes_max, limits_.frame_bytes_max);
    daemon_.window_bytes = std::min(daemon_.window_bytes, limits_.window_bytes_max);
    if (daemon_.chunk_rays_max == 0 || bulk_bytes_max() < protocol::alignment)
        return fail(Exit::cannot_connect, "the daemon takes no data: its limits are too small");
    return {};
}

int Connection::socket() const {
    return socket_->tls ? -1 : socket_->stream.native_handle();
}

void Connection::begin(std::chrono::milliseconds deadline) {
    ++id_;
    ended_by_ = 0;
    credit_ = daemon_.window_bytes;
    consumed_ = 0;
    patience_ = deadline.count() > 0 ? deadline + grace : Clock::duration::max();
}

Result<void> Connection::send(protocol::Result<Frame> frame, std::span<const std::byte> bulk) {
    if (!frame) return tl::unexpected<Failure>(failure(frame.error()));
    static constexpr std::array<std::byte, protocol::alignment> padding{};
    std::array<std::byte, protocol::header_bytes> header;
    protocol::write_header(frame->header, header);
    if (bulk.empty()) bulk = frame->bulk.span();
    std::array<asio::const_buffer, 4> parts = {
        asio::buffer(header), asio::buffer(frame->control.data(), frame->control.size()),
        asio::buffer(bulk.data(), bulk.size()),
        asio::buffer(padding, frame->header.bulk_bytes - bulk.size())};
    const std::size_t frame_bytes = asio::buffer_size(parts);
    for (std::size_t left = frame_bytes; left != 0 || !socket_->is_flushed();) {
        error_code error;
        std::size_t count = socket_->write_some(parts, error);
        left -= count;
        for (asio::const_buffer& part : parts) {
            const std::size_t taken = std::min(count, part.size());
            part += taken;
            count -= taken;
        }
        if (error == asio::error::would_block) {
            if (auto ready = wait(POLLOUT); !ready) return leave(ready.error(), left < frame_bytes);
        } else if (error && error != asio::error::interrupted) {
            return last_words(error.message());
        }
    }
    return {};
}

Result<void> Connection::last_words(const std::string& reason) {
    // A daemon that closes has sent what it has; one that goes on and on says nothing more.
    constexpr int frames_max = 1024;
    for (int i = 0; i < frames_max; ++i) {
        auto last = read_frame();
        if (!last && last.error().exit != Exit::failed)
            return tl::unexpected<Failure>(last.error());
        if (!last) return tagged(lost(Exit::failed, "the connection broke: " + reason));
        if (!is<wire::Error>(*last)) continue;
        if (const auto said = protocol::open<wire::Error>(*last))
            return tagged(failure({static_cast<protocol::Code>((*said)->code()),
                                   std::string(protocol::text((*said)->message())), 0}));
    }
    return tagged(lost(Exit::failed, "the connection broke: " + reason));
}

Result<void> Connection::grant(std::uint64_t bytes) {
    wire::CreditT credit;
    credit.bytes = bytes;
    return send(protocol::encode(id_, credit));
}

tl::unexpected<Failure> Connection::leave(const Failure& why, bool within_frame) {
    wire::CancelT message;
    message.reason = why.exit == Exit::interrupted ? "interrupted" : "deadline";
    const auto frame = protocol::encode(id_, message);
    std::vector<std::byte> bytes(protocol::header_bytes + frame->control.size());
    protocol::write_header(frame->header, std::span<std::byte, protocol::header_bytes>(
                                              bytes.data(), protocol::header_bytes));
    std::memcpy(bytes.data() + protocol::header_bytes, frame->control.data(),
                frame->control.size());
    error_code error;
    // If CANCEL cannot be sent at once, close the connection: that cancels the request too.
    const std::array<asio::const_buffer, 1> parts = {asio::buffer(bytes)};
    if (within_frame || socket_->write_some(parts, error) != bytes.size() || error)
        socket_->stream.shutdown(socket_->stream.shutdown_both, error);
    // Who interrupts a command has no question about it.
    return why.exit == Exit::interrupted ? tl::unexpected<Failure>(why) : tagged(why);
}

tl::unexpected<Failure> Connection::tagged(Failure why) const {
    if (id_ != 0) why.request = protocol::request_text(id_);
    return tl::unexpected<Failure>(std::move(why));
}

Result<Frame> Connection::next() {
    if (ended_by_ != 0)
        return tagged(
            daemon_sent(protocol::message_name(ended_by_) + " before the answer was whole")
                .value());
    while (true) {
        auto frame = read_frame();
        if (!frame) return frame;
        const bool ours = frame->header.request_id == id_;
        const bool about_connection = frame->header.request_id == 0;
        if (!ours && !about_connection) continue;

        if (is<wire::Error>(*frame)) {
            auto error = open_reply<wire::Error>(std::move(*frame));
            if (!error) return tl::unexpected<Failure>(error.error());
            return tagged(failure({static_cast<protocol::Code>((*error)->code()),
                                   std::string(protocol::text((*error)->message())),
                                   (*error)->retry_after_ms()}));
        }
        if (!ours) continue;
        if (is<wire::Credit>(*frame)) {
            const auto credit = open_sent<wire::Credit>(*frame);
            if (!credit) return tl::unexpected<Failure>(credit.error());
            credit_ += (*credit)->bytes();
        }
        consumed_ += frame->bulk.size();
        // Grant a quarter of the window at a time, so that the daemon never waits for credit.
        if (consumed_ >= limits_.window_bytes / 4) {
            if (auto granted = grant(std::exchange(consumed_, 0)); !granted)
                return tl::unexpected<Failure>(granted.error());
        }
        if (!is_continued(frame->header.type)) ended_by_ = frame->header.type;
        return frame;
    }
}

Result<Frame> Connection::read_frame() {
    while (true) {
        // Decode the bytes that were read ahead, then read the socket: bulk data directly into its
        // buffer, and the bytes after it in the same call.
        auto taken = decoder_.feed({staging_.get() + staged_begin_, staged_end_ - staged_begin_});
        if (!taken && taken.error().code == protocol::Code::resource_exhausted)
            return tl::unexpected<Failure>(failure(taken.error()));
        if (!taken) return daemon_sent("a broken frame: " + taken.error().message);
        staged_begin_ += *taken;
        if (decoder_.complete()) return decoder_.take();

        if (auto ready = wait(POLLIN); !ready) return leave(ready.error(), false);
        const std::span<std::byte> room = decoder_.room();
        const std::array<asio::mutable_buffer, 2> parts = {
            asio::buffer(room.data(), room.size()), asio::buffer(staging_.get(), staging_bytes)};
        error_code error;
        const std::size_t count = socket_->read_some(parts, error);
        if (error == asio::error::interrupted || error == asio::error::would_block) continue;
        if (error && socket_->tls && socket_->tls->why_broken().exit == Exit::not_allowed)
            return tl::unexpected<Failure>(socket_->tls->why_broken());
        if (error)
            return tagged(lost(Exit::failed, (error == asio::error::eof
                                                  ? "the daemon closed the connection"
                                                  : "the connection broke: " + error.message()) +
                                                 (decoder_.idle() ? "" : cut_short)));
        const std::size_t direct = std::min(count, room.size());
        decoder_.filled(direct);
        staged_begin_ = 0;
        staged_end_ = count - direct;
    }
}

Result<void> Connection::wait(short events) {
    while (true) {
        // A signal that comes between this test and poll() is missed. The short wait bounds the
        // delay.
        if (interrupted()) return fail(Exit::interrupted, "interrupted; the request was cancelled");
        if (patience_ < Clock::duration::zero())
            return fail(Exit::deadline, "no answer from the daemon within the deadline; " +
                                            failure({protocol::Code::deadline, "", 0}).message);
        if (events == POLLIN && socket_->tls && socket_->tls->has_bytes()) return {};
        pollfd waiting{socket_->stream.native_handle(), events, 0};
        const Clock::time_point begin = Clock::now();
        const int ready = ::poll(&waiting, 1, look_ms);
        if (patience_ != Clock::duration::max()) patience_ -= Clock::now() - begin;
        if (ready > 0) return {};
        if (ready < 0 && errno != EINTR)
            return tl::unexpected<Failure>(
                lost(Exit::failed, std::string("the connection broke: ") + std::strerror(errno)));
    }
}

}  // namespace raynest::client
