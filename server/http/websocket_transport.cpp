#include "server/http/websocket_transport.h"

#include "protocol/frame.h"
#include "protocol/text.h"
#include "protocol/wire.h"
#include "server/ground/limited_log.h"
#include "server/http/websocket_messages.h"
#include "server/net/minute_limit.h"
#include "server/net/socket_transport.h"
#include "server/net/turns.h"

#include <linux/sockios.h>
#include <sys/ioctl.h>

#include <algorithm>
#include <array>
#include <span>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

namespace websocket = beast::websocket;

/// Browsers send control frames only in answer to some, other clients a few in a minute.
constexpr unsigned control_frames_max = 1000;

/// A WebSocket that carries frames as websocket_messages.h says: each message is one frame.
class WebSocketTransport final : public Transport {
public:
    WebSocketTransport(HttpStream stream, PeerIdentity peer, PageRequest request,
                       const protocol::Limits& limits)
        : limits_(limits),
          peer_(std::move(peer)),
          request_(std::move(request)),
          stream_(std::move(stream)) {
        stream_.auto_fragment(false);
        stream_.read_message_max(limits.frame_bytes_max);
        stream_.set_option(websocket::stream_base::decorator([](websocket::response_type& made) {
            made.set(http::field::server, "raynestd/" RAYNEST_VERSION);
        }));
        stream_.control_callback([this](websocket::frame_type, beast::string_view) {
            control_frames_.count(MinuteLimit::Clock::now());
            if (control_frames_.is_over()) close_for_control_frames();
        });
    }

    [[nodiscard]] const PeerIdentity& peer() const override { return peer_; }

    asio::awaitable<void> open(SystemError& error) override {
        co_await stream_.async_accept(request_, asio::redirect_error(asio::use_awaitable, error));
        opened_ = !error;
    }
    asio::awaitable<std::size_t> read(const ReadBuffers& buffers, std::size_t wanted,
                                      SystemError& error) override;
    void pays(const std::string& principal) override { stream_.next_layer().pays(principal); }
    [[nodiscard]] bool reads_take_time() const override { return is_unparsed_; }
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
    void close() override { stream_.next_layer().close(); }
    bool is_lost() override { return peer_is_lost(stream_.next_layer().socket().native_handle()); }
    bool has_left() override {
        return peer_has_left(stream_.next_layer().socket().native_handle());
    }

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
    void close_for_control_frames();
    void refuse_upgrade(const WriteBatch::Rest& rest);

    /// Reads the next message up to its bulk part, and converts it unless it is a text.
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
    websocket::stream<HttpStream, false> stream_;
    std::string message_;  ///< received bytes of a message
    std::string frame_;    ///< header and control message of the frame that read() returns
    std::size_t frame_sent_ = 0;
    std::uint64_t bulk_left_ = 0;  ///< bytes of the bulk part that were not read yet
    std::optional<Unreadable> unreadable_;
    bool opened_ = false;
    bool in_message_ = false;  ///< a message has begun and not ended
    bool greeted_ = false;     ///< the first message has come
    /// A message has come, and is to be converted: to parse a text takes long
    bool is_unparsed_ = false;
    MinuteLimit control_frames_{control_frames_max};
};

asio::awaitable<std::size_t> WebSocketTransport::read(const ReadBuffers& buffers,
                                                      std::size_t /*wanted*/, SystemError& error) {
    unreadable_.reset();  // who reads on does not ask for it
    if (std::exchange(is_unparsed_, false)) {
        const auto began = Turns::Clock::now();
        convert(read_text_message(message_));
        // The caller counts the time of what it gets.
        if (unreadable_) stream_.next_layer().spend(Turns::Clock::now() - began);
    } else if (frame_sent_ == frame_.size() && bulk_left_ == 0) {
        co_await read_message(error);
    }
    if (error || unreadable_ || is_unparsed_) co_return 0;
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
        is_unparsed_ = true;
        co_return;
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
        read_binary_message(*header, std::string_view(message_).substr(protocol::header_bytes)));
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
    made.head = write_message(*header, bytes_of(*++part));
    if (header->bulk_bytes != 0) made.bulk = *++part;
    made.frame_bytes = header->frame_bytes();
    return made;
}

asio::awaitable<std::size_t> WebSocketTransport::write(const WriteBatch::Rest& rest,
                                                       SystemError& error) {
    Outgoing message;
    {
        const TurnMeter meter(stream_.next_layer().turns(), stream_.next_layer().payer());
        message = next_message(rest);
    }
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
    // A frame of Beast's own, such as a pong, waits to be written on.
    if (stream_.next_layer().has_unsent()) return 0;
    int waiting = 0;
    if (ioctl(stream_.next_layer().socket().native_handle(), SIOCOUTQ, &waiting) != 0 ||
        waiting != 0)
        return 0;
    const Outgoing message = next_message(rest);
    if (message.head.size() + message.bulk.size() > small_bytes_max) return 0;
    SystemError error;
    stream_.text(message.is_text);
    stream_.write(message.buffers(), error);
    if (error) close();
    return error ? 0 : message.frame_bytes;
}

void WebSocketTransport::close_for_control_frames() {
    if (!stream_.next_layer().socket().is_open()) return;
    log_limited(LogLevel::info, "dropped", peer_.name,
                {{"peer", peer_.whereabouts()},
                 {"reason", "more than " + std::to_string(control_frames_max) +
                                " control frames came in a minute"}});
    close();
}

void WebSocketTransport::refuse_upgrade(const WriteBatch::Rest& rest) {
    // The frame is Error: its text is the answer.
    const asio::const_buffer& control = *(rest.begin() + 1);
    const auto* error = flatbuffers::GetRoot<wire::Error>(control.data());
    const std::string why(protocol::text(error->message()));
    SystemError ignored;
    http::write(stream_.next_layer(),
                to_response(refuse_request(503, why), request_.version(), false), ignored);
}

}  // namespace

std::unique_ptr<Transport> make_websocket(HttpStream stream, PeerIdentity peer, PageRequest request,
                                          const protocol::Limits& limits) {
    return std::make_unique<WebSocketTransport>(std::move(stream), std::move(peer),
                                                std::move(request), limits);
}

}  // namespace raynest::server
