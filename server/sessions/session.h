// One connection: a reader, a writer and a watchdog coroutine around a Conversation.
//
//   Transport ──reader──► FrameDecoder ──► Conversation ──► outbox ──writer──► Transport
//                            watchdog: ticks of the jobs, deadlines of greeting and closing
//
// All run on one single-threaded io_context. The coroutines share this object and end when `open_`
// becomes false. A coroutine waits on a timer that others cancel; each timer has one waiter, which
// tests its condition again.
//
// The deadlines of greeting and closing are fixed when these begin. In between, a peer may pause
// until its place is needed (scheduling/peers.h); the pause begins when a whole frame was last sent
// or received. Single bytes extend none of the three.
#pragma once

#include "protocol/frame.h"
#include "server/net/asio.h"
#include "server/net/minute_limit.h"
#include "server/net/transport.h"
#include "server/net/turns.h"
#include "server/net/write_batch.h"
#include "server/requests/administration.h"
#include "server/scheduling/bandwidth.h"
#include "server/sessions/conversation.h"

#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest::server {

class Connections;

/// Writes an error before a connection is closed, as far as the socket accepts it without waiting.
/// No other frame may be partly written.
void write_last_error(Transport& transport, const protocol::Error& error);

/// A connection. Io thread only.
class Session final : public Sink, public Peer, public std::enable_shared_from_this<Session> {
public:
    /// `connections` owns the session and outlives it.
    Session(asio::io_context& io, std::unique_ptr<Transport> transport, Connections& connections,
            const Services& services, const JobContext& context);

    /// Starts the coroutines; they keep the session alive until all have ended.
    void start();
    /// Refuses new jobs; closes when the running ones have ended.
    void drain(const std::string& why);
    /// Ends the running jobs, sends the error, then closes.
    /// Returns false if the connection is closing already.
    bool close_with_error(const protocol::Error& error);
    /// The same, within a second also where the peer does not read.
    bool close_soon_with_error(const protocol::Error& error);
    /// Closes at once. Idempotent.
    void stop();
    /// Closes if the peer's machine or network is gone.
    void stop_if_lost();
    /// Stops one whose peer has left while its request waits, and so nothing is read.
    void stop_if_deserted();

    [[nodiscard]] const PeerIdentity& peer() const { return transport_->peer(); }
    [[nodiscard]] std::uint64_t number() const { return conversation_.number(); }
    [[nodiscard]] ConnectionRow row() const;
    [[nodiscard]] bool greeted() const { return conversation_.greeted(); }
    /// The client, once it is greeted.
    [[nodiscard]] const Principal& identity() const { return conversation_.identity(); }

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
    /// True unless the principal has used up its bandwidth for now.
    [[nodiscard]] bool is_turn(Bandwidth::Direction direction) const;
    /// Waits for it; others may cancel the timer meanwhile.
    asio::awaitable<void> wait_for_turn(Bandwidth::Direction direction, asio::steady_timer& timer);

    /// Fills the batch from the outbox; false if there is nothing to write.
    bool fill_stream();
    /// Writes answers without the writer coroutine, as far as the transport accepts them.
    void write_at_once();
    /// Counts `bytes` of the batch as sent.
    void sent(std::size_t bytes);

    /// Decodes received bytes and passes complete frames to the conversation until they or the turn
    /// end. Returns the bytes that are left.
    std::span<const std::byte> take_frames(std::span<const std::byte> bytes);
    /// Reads as Transport::read() does. `spent` becomes the time for which that kept the io thread, as
    /// far as the transport has not counted it.
    asio::awaitable<std::size_t> read_in_turn(const Transport::ReadBuffers& buffers,
                                              std::size_t wanted, Clock::duration& spent,
                                              SystemError& error);
    /// Waits for the next turn of its principal, if this one is over.
    asio::awaitable<void> take_turn();
    /// Updates the conversation and the watchdog. Call it after anything that may have changed a
    /// deadline or closed the conversation.
    void settle();
    /// True while so many answers are unread that no more requests are read.
    [[nodiscard]] bool crowded() const;
    [[nodiscard]] Clock::time_point next_deadline() const;
    void expire(Clock::time_point now);
    /// Counts, logs and closes a peer that does not respond.
    void drop(Metrics::Counter& counter, const char* why);

    const Services& services_;
    Connections& connections_;
    asio::io_context& io_;
    Turns& turns_;
    const std::unique_ptr<Transport> transport_;
    asio::steady_timer wake_;      ///< wakes the writer: there are frames, or the session closes
    asio::steady_timer room_;      ///< wakes the reader: the outbox shrank
    asio::steady_timer watchdog_;  ///< wakes the watchdog: a deadline became earlier
    protocol::FrameDecoder decoder_;
    std::vector<std::byte> stage_;
    std::deque<protocol::Frame> outbox_;
    WriteBatch batch_;
    std::uint64_t backlog_ = 0;          ///< bytes in the outbox and in the batch
    std::uint64_t control_backlog_ = 0;  ///< memory of waiting frames without bulk
    Conversation conversation_;
    Clock::time_point greeting_deadline_;
    Clock::time_point close_deadline_;  ///< set once the conversation is closing
    const Clock::time_point accepted_ = Clock::now();
    Clock::time_point moved_;  ///< when a whole frame was last sent or received
    /// Damaged messages; settle() ends a connection with too many
    MinuteLimit damage_;
    bool open_ = true;
    bool opened_ = false;   ///< the transport is ready for frames
    bool reading_ = false;  ///< received frames are being handled
    bool writing_ = false;  ///< the writer waits for the transport
};

}  // namespace raynest::server
