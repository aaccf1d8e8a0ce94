// A blocking conversation with a daemon: greet it, send a request, read its frames until the end.
//
// One request runs at a time. The connection counts both credits: the bytes that the client may
// send, and the bytes that it has received and must grant again. Ctrl-C (interrupt.h) cancels the
// request at the daemon and ends the wait. Only connection.cpp and the load test's echo include
// Boost.Asio; tls.h encrypts.
#pragma once

#include "client/ground/failure.h"
#include "client/net/access.h"
#include "protocol/control.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>

namespace raynest::client {

inline constexpr const char* default_uri = "tcp://127.0.0.1:31060";

/// The daemon's properties and limits, from its WELCOME.
struct Daemon {
    std::string name;
    std::uint64_t window_bytes = 0;
    std::uint64_t frame_bytes_max = 0;
    std::uint64_t chunk_rays_max = 0;
    std::string principal;  ///< the name under which the daemon knows this client
    std::string role;       ///< viewer, user or admin; empty: an older daemon
};

class Connection {
public:
    /// Connects to tls://HOST:PORT, tcp://HOST:PORT, with [IPV6] as a host, or to unix:PATH, and
    /// greets. Fails after 5 s with exit code 3, and with 4 if the daemon refuses this client.
    static Result<std::unique_ptr<Connection>> open(const std::string& uri, const Access& access);
    static Result<std::unique_ptr<Connection>> open(const std::string& uri,
                                                    const std::string& token) {
        return open(uri, Access{token, {}});
    }
    ~Connection();
    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;

    [[nodiscard]] const Daemon& daemon() const { return daemon_; }
    /// Returns the greeted socket, for code that writes frames itself; the connection keeps it. -1
    /// if it is encrypted.
    [[nodiscard]] int socket() const;

    /// Begins a request; frames of earlier ones are skipped from now on. Some time after the
    /// deadline, sending and next() fail, in case the daemon itself does not answer any more. Only
    /// time spent waiting for the daemon counts, not the caller's own.
    template <class Native>
    Result<void> start(const Native& request, std::chrono::milliseconds deadline = {}) {
        begin(deadline);
        return send(protocol::encode(id_, request));
    }
    /// Sends bulk data of the running request, which must fit credit().
    template <class Native>
    Result<void> send_bulk(Native message, protocol::Bulk bulk) {
        credit_ -= bulk.bytes();
        return send(protocol::encode(id_, std::move(message), std::move(bulk)));
    }
    /// The same for a single block, not allocated, whose bytes are sent without a copy.
    template <class Native>
    Result<void> send_bulk(Native message, protocol::Bulk bulk, std::span<const std::byte> bytes) {
        credit_ -= bulk.bytes();
        return send(protocol::encode(id_, std::move(message), std::move(bulk)), bytes);
    }
    /// Bulk bytes, with padding, that the client may send now.
    [[nodiscard]] std::uint64_t credit() const { return credit_; }
    /// Maximum bulk bytes of a frame; credit for that much always comes back.
    [[nodiscard]] std::uint64_t bulk_bytes_max() const {
        return std::min(daemon_.window_bytes / 2, daemon_.frame_bytes_max / 2);
    }

    /// Reads the next frame of the running request. CREDIT is returned too, already counted; ERROR
    /// is a Failure, and so is any wait for more after a frame that ends the request.
    Result<protocol::Frame> next();

private:
    struct Socket;
    explicit Connection(std::unique_ptr<Socket> socket);
    void begin(std::chrono::milliseconds deadline);
    Result<void> greet(const std::string& token);
    /// `bulk` is the bulk part that the frame announces, if the frame does not hold it itself.
    Result<void> send(protocol::Result<protocol::Frame> frame,
                      std::span<const std::byte> bulk = {});
    Result<void> grant(std::uint64_t bytes);
    Result<void> encrypt(const std::string& host, const TlsOptions& options);
    /// Returns the ERROR that a closing daemon has usually sent, else a failure with `reason`.
    Result<void> last_words(const std::string& reason);
    Result<protocol::Frame> read_frame();
    /// Waits until the socket is ready for these poll() events; fails on Ctrl-C or the deadline.
    Result<void> wait(short events);
    /// Cancels the request at the daemon. In the middle of a frame that is impossible, so that the
    /// connection is closed instead.
    tl::unexpected<Failure> leave(const Failure& why, bool within_frame);
    /// Adds the running request's id to a failure.
    [[nodiscard]] tl::unexpected<Failure> tagged(Failure why) const;

    using Clock = std::chrono::steady_clock;

    std::unique_ptr<Socket> socket_;
    protocol::Limits limits_;
    protocol::FrameDecoder decoder_{limits_};
    std::unique_ptr<std::byte[]> staging_;
    std::size_t staged_begin_ = 0;
    std::size_t staged_end_ = 0;
    Daemon daemon_;
    std::uint64_t id_ = 0;
    std::uint64_t credit_ = 0;
    std::uint64_t consumed_ = 0;                         ///< bulk bytes not yet granted again
    Clock::duration patience_ = Clock::duration::max();  ///< left for the daemon, in this request
    std::uint16_t ended_by_ = 0;  ///< type of the frame that has ended the request; 0: it runs
};

/// Reads a frame as an Answer. A broken one is a fault of the daemon.
template <class Answer>
Result<protocol::Opened<Answer>> open_sent(const protocol::Frame& frame) {
    auto opened = protocol::open<Answer>(frame);
    if (!opened)
        return daemon_sent("a broken " + protocol::message_name(frame.header.type) + ": " +
                           opened.error().message);
    return std::move(*opened);
}

/// An answer and the frame that holds it.
template <class Answer>
struct Reply {
    protocol::Frame frame;
    protocol::Opened<Answer> message;
    const Answer* operator->() const { return message.table; }
};

/// The same, with the frame.
template <class Answer>
Result<Reply<Answer>> open_reply(protocol::Frame frame) {
    Reply<Answer> reply{std::move(frame), {}};
    auto opened = open_sent<Answer>(reply.frame);
    if (!opened) return tl::unexpected<Failure>(opened.error());
    reply.message = std::move(*opened);
    return reply;
}

/// True for a frame with this message.
template <class Answer>
[[nodiscard]] bool is(const protocol::Frame& frame) {
    return frame.header.type == static_cast<std::uint16_t>(protocol::message_of<Answer>);
}

/// Sends a request that is answered by one frame, and reads that.
template <class Answer, class Native>
Result<Reply<Answer>> ask(Connection& connection, const Native& request) {
    if (auto sent = connection.start(request); !sent) return tl::unexpected<Failure>(sent.error());
    while (true) {
        auto frame = connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        if (is<Answer>(*frame)) return open_reply<Answer>(std::move(*frame));
    }
}

}  // namespace raynest::client
