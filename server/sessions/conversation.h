// The protocol's state machine for one client, without a transport.
//
//   greeting ──Hello──► open ──framing error, drained──► closing
//
// Frames come in through receive() and go out through the Sink, so fuzzers and tests run it in
// memory. The tables in conversation.cpp and requests/request.cpp say when each message is allowed
// and what it does. Io thread only.
#pragma once

#include "server/jobs/scene_poser.h"
#include "server/jobs/scene_waker.h"
#include "server/net/unreadable.h"
#include "server/requests/request.h"
#include "server/scheduling/detached.h"
#include "server/scheduling/runner.h"
#include "server/sessions/arriving_frame.h"
#include "server/sessions/waits.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

namespace raynest::server {

class Conversation {
public:
    /// Identifies the client by its Hello message; an error ends the connection.
    using Authenticate = std::function<Reply<Principal>(const wire::Hello&)>;

    /// `peer` names the client until it is authenticated.
    Conversation(const Services& services, const JobContext& context, Sink& sink, std::string peer,
                 Authenticate authenticate);
    ~Conversation() { abandon(); }
    Conversation(const Conversation&) = delete;

    /// Decides from a frame's header whether to read its bulk part, and covers that with memory.
    /// False: skip the bulk part. An error ends the connection.
    [[nodiscard]] Reply<bool> admit(const protocol::FrameHeader& header);

    /// Handles a frame, which admit() let in.
    void receive(protocol::Frame frame);
    /// Refuses a message that its transport could not read: ends its request, or the connection.
    void refuse_unreadable(const Unreadable& message);
    /// Sends the error to the client, then ends the connection.
    void close_with_error(const protocol::Error& error);
    /// Refuses new jobs and ends the connection when the running ones have ended: with this
    /// message, or the usual one.
    void drain(const std::string& why = {});

    [[nodiscard]] const std::string& principal() const { return caller_.principal; }
    /// Whose work is counted: the principal's, once it is greeted; empty before.
    [[nodiscard]] const std::string& counted_as() const {
        static const std::string nobody;
        return greeted_ ? caller_.principal : nobody;
    }
    /// The client, once it is greeted.
    [[nodiscard]] const Principal& identity() const { return caller_.identity; }
    /// The connection's number, which appears in lists and logs.
    [[nodiscard]] std::uint64_t number() const { return caller_.connection; }
    [[nodiscard]] bool greeted() const { return greeted_; }
    /// True once the last frame was sent: flush, then close.
    [[nodiscard]] bool closing() const { return closing_; }
    [[nodiscard]] Runner& runner() { return *runner_; }
    [[nodiscard]] const Runner& runner() const { return *runner_; }

    /// Number of requests that have begun, including detached ones whose data are still arriving.
    [[nodiscard]] std::size_t jobs() const { return runner_->size() + feeding_.size(); }
    /// The same and those that wait before they begin.
    [[nodiscard]] std::size_t in_flight() const { return jobs() + parked_.size(); }
    /// Bytes of --memory that these requests, their answers and the frame on its way have reserved.
    [[nodiscard]] std::uint64_t held_bytes() const;
    /// True while data have come for a request that waits for its scene. Meanwhile pass no frames
    /// on; `resumed` is called, on the io thread, when they may follow.
    [[nodiscard]] bool is_held_up() const { return held_up_.has_value(); }
    void set_resumed(std::function<void()> resumed) { resumed_ = std::move(resumed); }
    /// Returns when expire_parked() has something to do.
    [[nodiscard]] Clock::time_point next_deadline() const {
        Clock::time_point next = runner_->next_tick();
        for (const auto& [id, parked] : parked_) next = std::min(next, parked.deadline);
        return next;
    }
    /// Refuses the requests that wait for their scenes beyond their deadlines.
    void expire_parked(Clock::time_point now);
    /// True if every request waits for its client.
    [[nodiscard]] bool waits_for_client() const;

    /// Ends all requests that need the connection, because it is gone or about to end.
    void abandon(const protocol::Error& why = Runner::client_is_gone());
    /// Releases complete detached jobs, and closes a drained connection that has no jobs left. Call
    /// it after anything that may have ended a job.
    void settle();

private:
    /// A message that is no request of its own: a row of the table in conversation.cpp.
    struct Part;
    struct Parts;
    /// Returns null for other messages.
    [[nodiscard]] static const Part* find_part(std::uint16_t type);
    void greet(protocol::Frame frame);
    void ping(protocol::Frame frame);
    void credit(protocol::Frame frame);
    void cancel(protocol::Frame frame);
    void feed(protocol::Frame frame);

    /// Covers a bulk part with memory; false if its request wants none, or memory is short.
    bool cover(const protocol::FrameHeader& header);
    void handle(protocol::Frame frame);
    /// `deadline` and `waits`: of a request that was parked.
    void start(const Request& request, protocol::Frame frame,
               std::optional<Clock::time_point> deadline = std::nullopt, Waits waits = {});
    /// Calls `act`; an exception ends the request alone.
    void guard(std::uint64_t id, const std::function<void()>& act);
    /// A request that waits for its scene, or for a takeover.
    struct Parked {
        protocol::Frame frame;
        Budget::Lease lease;  ///< for the frame's bytes
        Admission::Slot slot;
        Clock::time_point deadline;
        Waits waits;
        std::shared_ptr<SceneWaker::Awake> awake;  ///< begins it once more
    };
    using ParkedRequests = std::map<std::uint64_t, Parked>;
    /// Calls `wait` with what begins the request once more. `deadline` and `waits`: of one that was
    /// parked before.
    void park(const Request& request, protocol::Frame frame,
              std::optional<Clock::time_point> deadline, Waits waits,
              const std::function<void(std::weak_ptr<SceneWaker::Awake>)>& wait);
    void resume(std::uint64_t id, const Reply<void>& ready);
    /// Ends a parked request with an error.
    void refuse_parked(ParkedRequests::iterator parked, const protocol::Error& error);
    /// Fails with QUOTA if the connection has as many requests in flight as it may have.
    [[nodiscard]] Reply<void> check_room() const;
    /// Handles the message that waited for a request which waits no more.
    void let_go_on();
    /// Returns the runner that has the request of this id: a detached job's, else the connection's.
    [[nodiscard]] Runner& runner_of(std::uint64_t id) const;
    Reply<void> detach(std::uint64_t id, JobSubmission accepted);
    /// Releases detached jobs that have all their data and so no longer need this connection.
    void release_inputs();
    /// Logs and answers a request that is refused.
    void refuse_request(std::uint64_t id, const protocol::Error& error);
    /// Answers a request whose refusal is logged already.
    void send_refusal(std::uint64_t id, const protocol::Error& error);

    const Services& services_;
    Sink& sink_;
    const Authenticate authenticate_;
    Caller caller_;
    std::shared_ptr<Runner> runner_;
    /// Detached jobs that still wait for data of this connection, by request id.
    std::map<std::uint64_t, DetachedJobs::Pointer> feeding_;
    int works_ = 0;  ///< WorksForPeer
    bool greeted_ = false;
    bool draining_ = false;
    std::string why_draining_ = {};
    bool waited_ = false;  ///< a Wait was sent and no Fetch since
    Clock::time_point fetch_until_ = Clock::time_point::max();
    bool closing_ = false;
    ParkedRequests parked_;                   ///< by request id
    std::optional<protocol::Frame> held_up_;  ///< data of a parked request
    ArrivingFrame arriving_;                  ///< or the held up one
    std::function<void()> resumed_;
};

}  // namespace raynest::server
