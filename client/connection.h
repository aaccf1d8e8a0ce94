// A blocking conversation with a daemon: greet, send a request, read its frames until the end.
//
// One request at a time. The connection counts both credits: what the daemon has granted for what
// we send, and what we have consumed and must grant again. Ctrl-C (interrupt.h) cancels the request
// at the daemon and ends the wait. connection.cpp and the load test's echo are the only files of
// the client that know Boost.Asio.
#pragma once

#include "client/failure.h"
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

/// What the daemon said of itself.
struct Daemon {
    std::string name;
    std::uint64_t window_bytes = 0;
    std::uint64_t frame_bytes_max = 0;
    std::uint64_t chunk_rays_max = 0;
};

class Connection {
public:
    /// `uri` is tcp://HOST:PORT, tcp://[IPV6]:PORT or unix:PATH; `token` may be empty. Connects and
    /// greets within 5 s, else exit code 3 (4: the daemon refuses the token).
    static Result<std::unique_ptr<Connection>> open(const std::string& uri,
                                                    const std::string& token);
    ~Connection();
    Connection(const Connection&) = delete;
    Connection& operator=(const Connection&) = delete;

    [[nodiscard]] const Daemon& daemon() const { return daemon_; }
    /// The greeted socket, for who speaks frames without this class; stays the connection's.
    [[nodiscard]] int socket() const;

    /// Begins a request; frames of earlier ones are skipped from now on. With a deadline, sending
    /// and next() give up a little after it, should the daemon itself not answer any more: only
    /// the time counts in which it is waited for, not the caller's own.
    template <class Native>
    Result<void> start(const Native& request, std::chrono::milliseconds deadline = {}) {
        begin(deadline);
        return send(protocol::encode(id_, request));
    }
    /// Sends bulk of the running request, which must fit credit().
    template <class Native>
    Result<void> send_bulk(Native message, protocol::Bulk bulk) {
        credit_ -= bulk.bytes();
        return send(protocol::encode(id_, std::move(message), std::move(bulk)));
    }
    /// The same for a single block, not allocated, whose bytes leave from where they lie.
    template <class Native>
    Result<void> send_bulk(Native message, protocol::Bulk bulk, std::span<const std::byte> bytes) {
        credit_ -= bulk.bytes();
        return send(protocol::encode(id_, std::move(message), std::move(bulk)), bytes);
    }
    /// Bulk bytes, padding included, that the daemon takes now.
    [[nodiscard]] std::uint64_t credit() const { return credit_; }
    /// The most bulk that one frame should have: credit for so much always comes back.
    [[nodiscard]] std::uint64_t bulk_bytes_max() const {
        return std::min(daemon_.window_bytes / 2, daemon_.frame_bytes_max / 2);
    }

    /// The next frame of the running request, CREDIT included (already counted). An ERROR frame is
    /// a Failure.
    Result<protocol::Frame> next();

private:
    struct Socket;
    explicit Connection(std::unique_ptr<Socket> socket);
    void begin(std::chrono::milliseconds deadline);
    Result<void> greet(const std::string& token);
    /// `bulk` takes the place of a bulk part that the frame announces and does not have.
    Result<void> send(protocol::Result<protocol::Frame> frame,
                      std::span<const std::byte> bulk = {});
    Result<void> grant(std::uint64_t bytes);
    /// A daemon that closes has usually said why: that is a better message than `reason`.
    Result<void> last_words(const std::string& reason);
    Result<protocol::Frame> read_frame();
    /// Until the socket is ready for these poll() events; a Ctrl-C and the deadline end it.
    Result<void> wait(short events);
    /// Ends the request at the daemon as well. Within a frame of ours there is no way back: that
    /// closes the connection.
    tl::unexpected<Failure> leave(const Failure& why, bool within_frame);

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
    Clock::duration patience_ = Clock::duration::max();  ///< with the daemon, in this request
};

/// An answer together with the frame that holds it.
template <class Answer>
struct Reply {
    protocol::Frame frame;
    protocol::Opened<Answer> message;
    const Answer* operator->() const { return message.table; }
};

/// Reads a frame as an Answer.
template <class Answer>
Result<Reply<Answer>> open_reply(protocol::Frame frame) {
    Reply<Answer> reply{std::move(frame), {}};
    auto opened = protocol::open<Answer>(reply.frame);
    if (!opened) return tl::unexpected<Failure>(failure(opened.error()));
    reply.message = std::move(*opened);
    return reply;
}

/// Is it a frame of this message?
template <class Answer>
[[nodiscard]] bool is(const protocol::Frame& frame) {
    return frame.header.type == static_cast<std::uint16_t>(protocol::message_of<Answer>);
}

/// A request with one answer.
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
