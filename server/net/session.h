// One connection: a reader, a writer and a watchdog coroutine around a Conversation.
//
//   Transport ──reader──► FrameDecoder ──► Conversation ──► outbox ──writer──► Transport
//                            watchdog: ticks of the jobs, deadlines of the greeting and the end
//
// All on one single-threaded io_context. The coroutines share this object and end when `open_`
// turns false; waiting is a timer that others cancel (one waiter each, the predicate tested again).
//
// The deadlines of the greeting and of the end are fixed when these begin. Between them a peer may
// take its time until somebody needs its place (jobs/peers.h): what counts there is when a whole
// frame last moved. No byte renews any of the three.
#pragma once

#include "protocol/frame.h"
#include "server/conversation.h"
#include "server/net/asio.h"
#include "server/net/transport.h"
#include "server/net/write_batch.h"

#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

class Connections;

/// Writes an error to a peer for which nothing else waits: it fits, or it does not matter.
void write_last_error(Transport& transport, const protocol::Error& error);

class Session final : public Sink, public Peer, public std::enable_shared_from_this<Session> {
public:
    /// Belongs to `connections`, which outlives it.
    Session(asio::io_context& io, std::unique_ptr<Transport> transport, Connections& connections,
            const Services& services, const JobContext& context);

    /// Starts the coroutines; they keep the session alive until all have ended.
    void start();
    /// No new jobs; closes when the running ones ended.
    void drain();
    /// Ends the running jobs with an error, then the connection.
    void close_with_error(const protocol::Error& error);
    /// Closes at once. Idempotent.
    void stop();
    /// Closes if the peer's machine or network is gone.
    void stop_if_lost();

    [[nodiscard]] const PeerIdentity& peer() const { return transport_->peer(); }

    [[nodiscard]] const std::string& principal() const override {
        return conversation_.principal();
    }
    [[nodiscard]] std::uint64_t holds(Resource resource) const override;
    [[nodiscard]] std::optional<Clock::time_point> paused_since() const override;
    void give_way(const protocol::Error& why) override;

    void send(protocol::Frame frame) override;
    [[nodiscard]] std::uint64_t backlog() const override { return backlog_; }

private:
    using Coroutine = asio::awaitable<void> (Session::*)();
    void spawn(Coroutine coroutine, const char* name);
    asio::awaitable<void> read_frames();
    asio::awaitable<void> read_some(SystemError& error);
    asio::awaitable<void> linger();
    asio::awaitable<void> write_frames();
    asio::awaitable<void> watch();
    static asio::awaitable<void> wait(asio::steady_timer& timer);

    /// Fills the batch from the outbox; false when there is nothing to write.
    bool fill_stream();
    /// Writes answers at once where the transport takes them; the writer gets the rest.
    void write_at_once();
    /// Counts `bytes` of the batch as sent.
    void sent(std::size_t bytes);

    /// Hands complete frames on.
    void take_frames(std::span<const std::byte> bytes);
    /// To be called after anything that may have moved a deadline or closed the conversation.
    void settle();
    /// True while so many answers wait that no more requests are read.
    [[nodiscard]] bool crowded() const;
    [[nodiscard]] Clock::time_point next_deadline() const;
    void expire(Clock::time_point now);
    /// Counts and names a peer that is closed for what it does not do, and closes.
    void drop(Metrics::Counter& counter, const char* why);

    const Services& services_;
    Connections& connections_;
    asio::io_context& io_;
    const std::unique_ptr<Transport> transport_;
    asio::steady_timer wake_;      ///< the writer: there are frames, or the end came
    asio::steady_timer room_;      ///< the reader: the outbox shrank
    asio::steady_timer watchdog_;  ///< the watchdog: a deadline came nearer
    protocol::FrameDecoder decoder_;
    std::vector<std::byte> stage_;
    std::deque<protocol::Frame> outbox_;
    WriteBatch batch_;
    std::uint64_t backlog_ = 0;          ///< bytes in the outbox and in the batch
    std::uint64_t control_backlog_ = 0;  ///< the part that is not bulk, with its cost in memory
    Conversation conversation_;
    Clock::time_point greeting_deadline_;
    Clock::time_point close_deadline_;  ///< once the conversation is closing
    Clock::time_point moved_;           ///< when a whole frame last came or left
    bool open_ = true;
    bool opened_ = false;   ///< the transport carries frames
    bool reading_ = false;  ///< frames that came are being handled
    bool writing_ = false;  ///< the writer waits for the transport
};

}  // namespace raynest::server
