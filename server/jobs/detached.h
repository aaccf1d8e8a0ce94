// Jobs that outlive their connection: what they answer is kept in memory until somebody fetches it.
//
//   start ──► running ──► kept ──► gone: its time is over, or it was fetched and room is needed
//               │  frames of the answer are stored, in room reserved before the first ray, and more
//               │  as they come where nobody knows how many hits there will be
//
// A detached job is a Runner of its own whose sink is memory. It needs the connection that asked
// until all its data have come, and no longer. Everything is lost with the daemon.
#pragma once

#include "server/jobs/runner.h"

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// One job and what it has answered so far. Io thread only, but for the answer of one that ended.
class DetachedJob final : private Sink {
public:
    /// Gives room for so many bytes more, or says why not.
    using MoreRoom = std::function<Reply<Budget::Lease>(std::uint64_t bytes)>;
    DetachedJob(const JobContext& context, JobRecord record, Budget::Lease room,
                MoreRoom more_room);
    ~DetachedJob() { runner_->abandon(); }
    DetachedJob(const DetachedJob&) = delete;

    [[nodiscard]] const JobRecord& record() const { return record_; }
    /// The frames that an attached client would have read from Started to Done, but for Progress.
    [[nodiscard]] const std::vector<protocol::Frame>& answer() const { return answer_; }
    /// Bytes of the answer; while the job runs, as many as are reserved.
    [[nodiscard]] std::uint64_t bytes() const { return room_.bytes(); }
    [[nodiscard]] bool ended() const { return ended_ != Clock::time_point::max(); }
    /// Why it failed, once it has ended.
    [[nodiscard]] const std::optional<protocol::Error>& error() const { return error_; }
    /// When its answer goes away.
    [[nodiscard]] Clock::time_point expiry() const;
    void set_fetched() { fetched_ = true; }

    [[nodiscard]] Runner& runner() { return *runner_; }
    [[nodiscard]] const Runner& runner() const { return *runner_; }
    /// The connection that sends the job's data: it hears of credit and of failure; null for none.
    void set_feeder(Sink* feeder) { feeder_ = feeder; }

private:
    friend class DetachedJobs;
    void send(protocol::Frame frame) override;
    [[nodiscard]] std::uint64_t backlog() const override { return 0; }
    void end(std::optional<protocol::Error> error);

    const JobContext& context_;
    JobRecord record_;
    Budget::Lease room_;
    const MoreRoom more_room_;
    std::shared_ptr<Runner> runner_;
    Sink* feeder_ = nullptr;
    std::vector<protocol::Frame> answer_;
    std::uint64_t answer_bytes_ = 0;
    std::optional<protocol::Error> error_;
    Clock::time_point ended_ = Clock::time_point::max();
    bool fetched_ = false;
};

/// All of them. Io thread only.
class DetachedJobs {
public:
    using Pointer = std::shared_ptr<DetachedJob>;

    /// `changed` is called when next_tick() may have come nearer.
    DetachedJobs(const JobContext& context, std::function<void()> changed)
        : context_(context),
          changed_(std::move(changed)) {}
    DetachedJobs(const DetachedJobs&) = delete;

    /// Starts a job whose frames carry `request_id`. Room for its answer is made by dropping what
    /// was fetched, the oldest first: QUOTA when the principal keeps too much, RESOURCE_EXHAUSTED
    /// when --memory is short. `feeder` hears what happens in here, it may be null; afterwards the
    /// caller sets one.
    Reply<Pointer> start(const std::string& principal, std::uint64_t request_id,
                         JobSubmission accepted, Sink* feeder = nullptr);

    /// JOB_UNKNOWN where there is no such job.
    [[nodiscard]] Reply<Pointer> find(std::uint64_t number) const;
    [[nodiscard]] const std::map<std::uint64_t, Pointer>& all() const { return jobs_; }
    /// Stops it if it runs, and drops what it has answered.
    void cancel(std::uint64_t number);
    /// Stops those that run, with DRAINING: the daemon ends.
    void stop_running();

    /// Deadlines of the jobs and of what is kept.
    void tick(Clock::time_point now);
    [[nodiscard]] Clock::time_point next_tick() const;

private:
    /// `less` says how to ask for a smaller answer.
    Reply<Budget::Lease> make_room(const std::string& principal, std::uint64_t bytes,
                                   const std::string& less);
    /// Drops the oldest answer that was fetched; false when there is none. An empty principal: of
    /// anybody.
    bool drop_fetched(const std::string& principal);

    const JobContext& context_;
    const std::function<void()> changed_;
    std::map<std::uint64_t, Pointer> jobs_;  ///< by number, so in order of their starts
};

}  // namespace raynest::server
