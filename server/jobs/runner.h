// Runs the jobs of one connection: hands their tasks to workers while the client's credit and the
// connection's window have room, collects answers, ends jobs on error, cancel and deadline.
//
// Knows no sockets: frames go to a Sink, completions come back through `post`. Everything here runs
// on the io thread; only tasks run elsewhere, and what they share with it is a StopFlag.
#pragma once

#include "protocol/limits.h"
#include "server/diag/metrics.h"
#include "server/execution/fair_thread_pool.h"
#include "server/jobs/admission.h"
#include "server/jobs/coalescer.h"
#include "server/jobs/dispatched_task.h"
#include "server/jobs/inline_budget.h"
#include "server/jobs/job.h"
#include "server/jobs/peers.h"
#include "server/store/budget.h"

#include <functional>
#include <list>
#include <memory>
#include <string>

namespace raynest::server {

/// Where frames go; implemented by the session.
class Sink {
public:
    virtual void send(protocol::Frame frame) = 0;
    /// Bytes that were sent but have not left yet.
    [[nodiscard]] virtual std::uint64_t backlog() const = 0;

protected:
    ~Sink() = default;
};

/// Shared by all runners of a daemon; outlives them.
struct JobContext {
    FairThreadPool& compute;
    Admission& admission;
    Metrics& metrics;
    const protocol::Limits& limits;
    Post post;
    Budget& budget;
    InlineBudget& inline_budget;
    Coalescer& coalescer;
    Peers& peers;
};

class Runner : public std::enable_shared_from_this<Runner> {
public:
    /// All jobs are the principal's, in quotas and at the workers.
    Runner(const JobContext& context, Sink& sink, std::string principal)
        : context_(context),
          sink_(&sink),
          principal_(std::move(principal)) {}

    /// Called before the first job, once the client is known.
    void set_principal(std::string principal) { principal_ = std::move(principal); }
    /// The credit that the client grants to each request at its start.
    void set_window(std::uint64_t bytes) { window_bytes_ = bytes; }

    /// Is a job of this id under way?
    [[nodiscard]] bool knows(std::uint64_t id) const;
    [[nodiscard]] std::size_t size() const { return jobs_.size(); }

    /// Starts a job, with memory for what its client may send before it is taken, and for what may
    /// wait for the client to read it; QUOTA (of the principal; jobs_max is the connection's to
    /// count), BUSY or RESOURCE_EXHAUSTED when it may not, and no peer gives way to it.
    /// Gives the job's number among all of the daemon's.
    Reply<std::uint64_t> start(std::uint64_t id, JobSubmission accepted);
    /// Is there memory for so many bulk bytes to a job? Not to one that has ended, and not beyond
    /// its credit.
    [[nodiscard]] bool expects(std::uint64_t id, std::uint64_t bytes) const;
    /// Bulk data for a job; that of a job that already ended is dropped: it was on its way.
    void feed(protocol::Frame frame);
    /// The client grants `bytes` more.
    void grant(std::uint64_t id, std::uint64_t bytes);
    void cancel(std::uint64_t id);
    void cancel_all();
    /// Ends a job with ERROR; one that has ended stays as it is.
    void fail(std::uint64_t id, const protocol::Error& error);
    void fail_all(const protocol::Error& error);
    /// Has a job something to do with its client yet: data to come, or an error to tell?
    [[nodiscard]] bool needs_client(std::uint64_t id) const;

    /// Bytes left: the sink has room again.
    void pump();
    /// Deadlines and progress; the session calls it at next_tick().
    void tick(Clock::time_point now);
    [[nodiscard]] Clock::time_point next_tick() const;
    /// Is the next move of every job its client's: to send data, to grant credit, to read?
    [[nodiscard]] bool waits_for_client() const;
    /// Bytes of --memory that its jobs and their answers have reserved.
    [[nodiscard]] std::uint64_t held_bytes() const;

    /// The connection is gone: all jobs stop, nothing is sent any more.
    void abandon();

private:
    /// A task that was submitted.
    struct Outstanding {
        std::uint64_t reserved = 0;  ///< of its job's credit
        const FairThreadPool* pool = nullptr;
        TryDequeue try_dequeue = {};
    };
    struct Active {
        Active(std::uint64_t request_id, std::unique_ptr<Job> work, Clock::time_point deadline)
            : id(request_id),
              job(std::move(work)),
              stop(deadline) {}
        const std::uint64_t id;
        std::unique_ptr<Job> job;  ///< gone once finished, whoever still holds this record
        StopFlag stop;
        Admission::Slot slot;
        Budget::Lease input;  ///< of fed frames that are not free yet
        Priority priority = Priority::normal;
        Clock::time_point started;
        Clock::time_point next_progress;
        std::optional<protocol::Error> error;  ///< why the job ends early
        std::optional<Task> parked;            ///< taken from the job, waits for room
        std::list<Outstanding> tasks;          ///< that wait for a worker or run
        std::uint64_t credit = 0;              ///< what we may still send
        std::uint64_t reserved = 0;            ///< of it, promised to running tasks
        std::uint64_t input_credit = 0;        ///< what the client may still send
        std::uint64_t returned = 0;  ///< input bytes that are free but not yet granted again
    };
    using ActivePointer = std::shared_ptr<Active>;

    ActivePointer find(std::uint64_t id) const;
    /// A place for the job, if need be that of a peer that pauses.
    Reply<Admission::Slot> enter(JobRecord record);
    /// Without memory for `step` the job fails, as it would for lack of it in a task.
    template <class Step>
    void guarded(Active& active, Step step);
    void pump(const ActivePointer& active);
    [[nodiscard]] FairThreadPool& pool_of(const Task& task) const {
        return task.pool != nullptr ? *task.pool : context_.compute;
    }
    /// Is there a thread for the task, and room for its answer?
    [[nodiscard]] bool may_start(const Active& active, const Task& task) const;
    /// On the io thread; false where its turn is over, or ends before the task does.
    bool run_inline(Active& active, const Task& task);
    void submit(const ActivePointer& active, Task task);
    void take_answer(Active& active, Reply<Frames> reply);
    void task_ended(const ActivePointer& active, std::list<Outstanding>::iterator task,
                    Reply<Frames> reply);
    /// A submitted task that runs no more.
    void forget(Active& active, std::list<Outstanding>::iterator task);
    void return_input(Active& active, std::uint64_t bytes);
    /// Without jobs the memory for answers is that of those which have not left yet.
    void shrink_answers();
    void stop(Active& active, protocol::Error error);
    void finish(const ActivePointer& active);

    const JobContext& context_;
    Sink* sink_;  ///< null once abandoned
    std::string principal_;
    std::list<ActivePointer> jobs_;
    std::uint64_t window_bytes_ = 0;
    std::uint64_t in_flight_bytes_ = 0;  ///< reserved by running tasks of all jobs
    /// For what running tasks answer and what waits to leave, a window's worth at most. It outlives
    /// its jobs: an answer that nobody reads takes memory although its job has ended.
    Budget::Lease answers_;
};

}  // namespace raynest::server
