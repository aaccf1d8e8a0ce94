// One connection: a reader, a writer and a watchdog coroutine around a Conversation.
//
//   socket ──reader──► FrameDecoder ──► Conversation ──► outbox ──writer──► socket
//                          watchdog: ticks of the jobs, deadlines of the greeting and the end
//
// All on one single-threaded io_context. The coroutines share this object and end when `open_`
// turns false; waiting is a timer that others cancel (one waiter each, the predicate tested again).
// Between greeting and end a peer may take its time, until somebody needs its place (jobs/peers.h).
#pragma once

#include "protocol/frame.h"
#include "server/conversation.h"
#include "server/net/asio.h"
#include "server/net/gather.h"

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// The last words into a socket for which nothing waits: they fit, or they do not matter.
void say_last(Socket& socket, const protocol::Error& error);

class Session final : public Sink, public Peer, public std::enable_shared_from_this<Session> {
public:
    using OnClosed = std::function<void(const std::shared_ptr<Session>&)>;

    /// `principal` as principal_of() gives it.
    Session(asio::io_context& io, Socket socket, std::string principal, const Services& services,
            const Engine& engine, OnClosed on_closed);

    /// Starts the coroutines; they keep the session alive until all have ended.
    void start();
    /// No new jobs; closes when the running ones ended.
    void drain();
    /// Ends what runs, and says so.
    void give_up();
    /// Closes at once. Idempotent.
    void stop();
    /// Closes where the peer's machine or network is gone.
    void stop_if_lost();

    [[nodiscard]] const std::string& principal() const override {
        return conversation_.principal();
    }
    [[nodiscard]] std::uint64_t holds(Resource resource) const override;
    [[nodiscard]] std::optional<Clock::time_point> paused_since() const override;
    void give_way(const protocol::Error& why) override;

    void send(protocol::Frame frame) override;
    [[nodiscard]] std::uint64_t backlog() const override { return backlog_; }

private:
    using Part = asio::awaitable<void> (Session::*)();
    void spawn(Part part, const char* name);
    asio::awaitable<void> read_frames();
    asio::awaitable<void> read_some(SystemError& error);
    /// Reading wakes up once so many bytes are there.
    void expect(std::size_t bytes);
    asio::awaitable<void> linger();
    asio::awaitable<void> write_frames();
    asio::awaitable<void> watch();
    static asio::awaitable<void> wait(asio::steady_timer& timer);

    /// Fills the gather from the outbox; false when there is nothing to write.
    bool gather();
    /// Answers leave at once where the socket takes them; what it does not take is the writer's.
    void write_at_once();
    /// So many bytes of the gather have left.
    void sent(std::size_t bytes);

    /// Hands complete frames on; false when framing is lost.
    void take_frames(std::span<const std::byte> bytes);
    /// After anything that may have moved a deadline or closed the conversation.
    void settle();
    /// Do so many answers wait that no more requests are read?
    [[nodiscard]] bool crowded() const;
    [[nodiscard]] Clock::time_point next_deadline() const;
    void expire(Clock::time_point now);

    const Services& services_;
    OnClosed on_closed_;
    Socket socket_;
    asio::steady_timer wake_;      ///< the writer: there are frames, or the end came
    asio::steady_timer room_;      ///< the reader: the outbox shrank
    asio::steady_timer watchdog_;  ///< the watchdog: a deadline came nearer
    protocol::FrameDecoder decoder_;
    std::vector<std::byte> stage_;
    std::deque<protocol::Frame> outbox_;
    Gather gather_;
    std::uint64_t backlog_ = 0;          ///< bytes in the outbox and in the gather
    std::uint64_t control_backlog_ = 0;  ///< of them, what is no bulk, with its cost in memory
    Conversation conversation_;
    Clock::time_point greeting_deadline_;
    Clock::time_point close_deadline_;  ///< once the conversation is closing
    Clock::time_point moved_;           ///< when a whole frame last came or left
    std::size_t expected_ = 1;          ///< bytes that wake the reader up
    bool open_ = true;
    bool reading_ = false;  ///< frames that came are being handled
    bool writing_ = false;  ///< the writer waits for the socket
};

}  // namespace raynest::server
