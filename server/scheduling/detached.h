// Jobs that outlive their connection: their answers are kept in memory until they are fetched.
//
//   start ──► running ──► kept ──► gone: it expired, or it was fetched and its room is needed
//               │  stores the frames of the answer in room that is reserved before the first ray;
//               │  for an unknown number of hits, reserves more as they come
//
// A detached job has a Runner of its own whose sink is memory. It needs the requesting connection
// only until all its data have come. All jobs are lost when the daemon ends.
#pragma once

#include "server/scheduling/runner.h"
#include "server/security/principal.h"

#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string>

namespace raynest::server {

/// A job and its answer so far. Io thread only, except that any thread may read the answer of a job
/// that has ended.
class DetachedJob final : private Sink {
public:
    /// Reserves `bytes` more for the answer.
    using MoreRoom = std::function<Reply<Budget::Lease>(std::uint64_t bytes)>;
    DetachedJob(const JobContext& context, JobRecord record, Principal owner, Budget::Lease room,
                MoreRoom more_room);
    ~DetachedJob();
    DetachedJob(const DetachedJob&) = delete;

    [[nodiscard]] const JobRecord& record() const { return record_; }
    /// The principal, as it was admitted. Its login of the page may have ended: the job outlives
    /// it.
    [[nodiscard]] const Principal& owner() const { return owner_; }
    /// Frames that are kept, and sums over them. An answer may have millions, so that the io thread
    /// looks at each only once.
    struct Answer {
        std::list<protocol::Frame> frames = {};
        std::uint64_t frame_bytes = 0;
        std::uint64_t bulk_bytes = 0;
        std::uint64_t largest_bulk = 0;

        void add(protocol::Frame frame);
    };

    /// The frames that an attached client would receive, from Started to Done, without Progress.
    [[nodiscard]] const Answer& answer() const { return answer_; }
    /// The latest whole picture of a running job that refines one, as its frames; null: none yet.
    [[nodiscard]] const std::shared_ptr<const Answer>& preview() const { return preview_; }
    /// Bytes of the answer; while the job runs, the bytes reserved for it.
    [[nodiscard]] std::uint64_t bytes() const { return room_.bytes(); }
    [[nodiscard]] bool ended() const { return ended_ != Clock::time_point::max(); }
    /// The error of a job that has ended, if it failed.
    [[nodiscard]] const std::optional<protocol::Error>& error() const { return error_; }
    /// Time at which the answer is dropped; max while the job runs.
    [[nodiscard]] Clock::time_point expiry() const;
    void set_fetched() { fetched_ = true; }

    [[nodiscard]] Runner& runner() { return *runner_; }
    [[nodiscard]] const Runner& runner() const { return *runner_; }
    /// Sets the connection that sends the job's data and receives its credit and errors; null:
    /// none.
    void set_feeder(Sink* feeder) { feeder_ = feeder; }

private:
    friend class DetachedJobs;
    void send(protocol::Frame frame) override;
    [[nodiscard]] std::uint64_t backlog() const override { return 0; }
    void end(std::optional<protocol::Error> error);
    /// Keeps a frame of a picture that a later one replaces.
    void keep_preview(protocol::Frame frame, bool begins, bool ends);

    const JobContext& context_;
    JobRecord record_;
    const Principal owner_;
    Budget::Lease room_;
    const MoreRoom more_room_;
    std::shared_ptr<Runner> runner_;
    Sink* feeder_ = nullptr;
    /// Frees the frames, many of them on a compute thread.
    void drop(Answer& answer) noexcept;
    [[nodiscard]] std::uint64_t kept_bytes() const {
        return answer_.frame_bytes + arriving_.frame_bytes +
               (preview_ == nullptr ? 0 : preview_->frame_bytes);
    }

    Answer answer_;
    Answer arriving_;  ///< a preview that is not yet whole
    std::shared_ptr<const Answer> preview_;
    std::optional<protocol::Error> error_;
    Clock::time_point ended_ = Clock::time_point::max();
    bool fetched_ = false;
};

/// All detached jobs. Io thread only.
class DetachedJobs {
public:
    using Pointer = std::shared_ptr<DetachedJob>;

    /// `changed` is called when next_tick() may have become earlier.
    DetachedJobs(const JobContext& context, std::function<void()> changed)
        : context_(context),
          changed_(std::move(changed)) {}
    DetachedJobs(const DetachedJobs&) = delete;

    /// Starts a job whose frames carry `request_id`. Drops fetched answers of the principal, oldest
    /// first, to make room for the job's answer. Fails with QUOTA if the principal keeps too much,
    /// with RESOURCE_EXHAUSTED if --memory is short. `feeder`, which may be null, receives frames
    /// during this call; afterwards the caller sets the feeder.
    Reply<Pointer> start(const Principal& owner, std::uint64_t request_id, JobSubmission accepted,
                         Sink* feeder = nullptr);

    /// Fails with JOB_UNKNOWN if there is no such job.
    [[nodiscard]] Reply<Pointer> find(std::uint64_t number) const;
    /// Returns the error JOB_UNKNOWN.
    [[nodiscard]] protocol::Error unknown(std::uint64_t number) const;
    [[nodiscard]] const std::map<std::uint64_t, Pointer>& all() const { return jobs_; }
    /// Stops a job if it runs, and drops its answer.
    void cancel(std::uint64_t number);
    /// Drops all jobs and answers. Call it while the compute threads are there to free them.
    void clear() { jobs_.clear(); }
    /// Ends all running jobs with DRAINING.
    void stop_running();
    /// Ends the running jobs of owners for which `valid` returns false with this error. Answers
    /// stay.
    void end_unless(const std::function<bool(const Principal&)>& valid,
                    const protocol::Error& error);

    /// Enforces the deadlines of running jobs and the expiry of answers.
    void tick(Clock::time_point now);
    [[nodiscard]] Clock::time_point next_tick() const;

private:
    /// Reserves memory for an answer; drops the principal's fetched answers if needed. `advice` is
    /// the remedy for the error message on how to ask for a smaller answer.
    Reply<Budget::Lease> make_room(const std::string& principal, std::uint64_t bytes,
                                   const std::string& advice);
    /// Drops the oldest fetched answer of a principal. Returns false if there is none.
    bool drop_fetched(const std::string& principal);

    const JobContext& context_;
    const std::function<void()> changed_;
    std::map<std::uint64_t, Pointer> jobs_;  ///< by number, so in order of start
};

}  // namespace raynest::server
