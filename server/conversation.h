// What one client may say and what it hears: the protocol's state machine, without a transport.
//
//   greeting ──Hello──► open ──fault of framing, drained──► closing
//
// Frames come in through receive() and go out through the Sink; a fuzzer or a test drives it over
// plain memory. Which message may come when, and what it does, is a row of the table in
// handlers/handler.cpp. Io thread only.
#pragma once

#include "server/handlers/handler.h"
#include "server/jobs/runner.h"

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

namespace raynest::server {

class Conversation {
public:
    /// Decides who the client is once it has said Hello; an error ends the connection.
    using Authenticate = std::function<Reply<Principal>(const wire::Hello&)>;

    /// `peer` names the client until it is authenticated.
    Conversation(const Services& services, const JobContext& context, Sink& sink, std::string peer,
                 Authenticate authenticate);
    ~Conversation() { abandon(); }
    Conversation(const Conversation&) = delete;

    /// True if there is memory for the bulk part of this frame. Decides by its header alone; an
    /// error ends the connection, false lets the bulk pass unread.
    [[nodiscard]] Reply<bool> admit(const protocol::FrameHeader& header) const;

    void receive(protocol::Frame frame);
    /// Tells the client why the connection ends, and ends it.
    void close_with_error(const protocol::Error& error);
    /// No new jobs; ends the connection when the running ones ended.
    void drain();

    [[nodiscard]] const std::string& principal() const { return caller_.principal; }
    [[nodiscard]] bool greeted() const { return greeted_; }
    /// The last frame was sent: flush, then close.
    [[nodiscard]] bool closing() const { return closing_; }
    [[nodiscard]] Runner& runner() { return *runner_; }
    [[nodiscard]] const Runner& runner() const { return *runner_; }

    /// Number of requests in flight, including those that are detached once their data have come.
    [[nodiscard]] std::size_t jobs() const { return runner_->size() + feeding_.size(); }
    /// Bytes of --memory that they and their answers have reserved.
    [[nodiscard]] std::uint64_t held_bytes() const;
    /// True if every request waits for its client.
    [[nodiscard]] bool waits_for_client() const;

    /// The connection is gone: what still needs it ends.
    void abandon();
    /// To be called after anything that may have ended a job.
    void settle();

private:
    friend struct RequestTable;  // its rows name what follows
    void greet(protocol::Frame frame);
    void ping(protocol::Frame frame);
    void credit(protocol::Frame frame);
    void cancel(protocol::Frame frame);
    void feed(protocol::Frame frame);

    void handle(protocol::Frame frame);
    void start(const Request& request, const protocol::Frame& frame);
    /// The runner of the request of this id, if there is such a request.
    [[nodiscard]] Runner& runner_of(std::uint64_t id) const;
    Reply<void> detach(std::uint64_t id, JobSubmission accepted);
    /// Detached jobs that have all their data need this connection no longer.
    void release_inputs();
    void refuse_request(std::uint64_t id, const protocol::Error& error);

    const Services& services_;
    Sink& sink_;
    const Authenticate authenticate_;
    Caller caller_;
    std::shared_ptr<Runner> runner_;
    /// Detached jobs that still wait for data of this connection, by request id.
    std::map<std::uint64_t, DetachedJobs::Pointer> feeding_;
    bool greeted_ = false;
    bool draining_ = false;
    bool closing_ = false;
};

}  // namespace raynest::server
