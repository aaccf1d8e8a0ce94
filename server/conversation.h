// What one client may say and what it hears: the protocol's state machine, without a socket.
//
//   greeting ──Hello──► open ──fault of framing, drained──► closing
//
// Frames come in through receive(), go out through the Sink; a fuzzer or a test drives it over
// plain memory. Io thread only.
#pragma once

#include "server/handlers/handler.h"
#include "server/jobs/runner.h"

#include <cstdint>
#include <map>
#include <memory>
#include <string>

namespace raynest::server {

class Conversation {
public:
    /// `principal` owns what this client loads: "uid:1000", "127.0.0.1".
    Conversation(const Services& services, const Engine& engine, Sink& sink, std::string principal);
    ~Conversation() { abandon(); }
    Conversation(const Conversation&) = delete;

    /// Is there memory for the bulk part of this frame? Told from its header alone; an error ends
    /// the connection, false lets the bulk pass unread.
    [[nodiscard]] Reply<bool> admit(const protocol::FrameHeader& header) const;

    void receive(protocol::Frame frame);
    /// Tells the client why the connection ends, and ends it: for what cannot be answered
    /// otherwise.
    void give_up(const protocol::Error& error);
    /// No new jobs; ends the connection when the running ones ended.
    void drain();

    [[nodiscard]] const std::string& principal() const { return caller_.principal; }
    [[nodiscard]] bool greeted() const { return greeted_; }
    /// The last frame was sent: flush, then close.
    [[nodiscard]] bool closing() const { return closing_; }
    [[nodiscard]] Runner& runner() { return *runner_; }
    [[nodiscard]] const Runner& runner() const { return *runner_; }

    /// Requests in flight, those included whose data are to come before they are detached.
    [[nodiscard]] std::size_t jobs() const { return runner_->size() + feeding_.size(); }
    /// Bytes of --memory that they and their answers have reserved.
    [[nodiscard]] std::uint64_t held_bytes() const;
    /// Is the next move of every request its client's?
    [[nodiscard]] bool waits_for_client() const;

    /// The connection is gone: what still needs it ends.
    void abandon();
    /// To be called after anything that may have ended a job.
    void settle();

private:
    void greet(const protocol::Frame& frame);
    void control(const protocol::Frame& frame, wire::Message type);
    void request(const protocol::Frame& frame);
    void feed(protocol::Frame frame);
    /// Of the request of this id, if there is one.
    [[nodiscard]] Runner& runner_of(std::uint64_t id) const;
    Reply<void> detach(std::uint64_t id, Accepted accepted);
    void let_go();
    void refuse_request(std::uint64_t id, const protocol::Error& error);

    const Services& services_;
    Sink& sink_;
    Caller caller_;
    std::shared_ptr<Runner> runner_;
    /// Detached jobs that still wait for data of this connection, by request id.
    std::map<std::uint64_t, DetachedJobs::Pointer> feeding_;
    bool greeted_ = false;
    bool draining_ = false;
    bool closing_ = false;
};

}  // namespace raynest::server
