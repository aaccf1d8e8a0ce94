// Runs the jobs of one connection: submits their tasks to workers while the client's credit and the
// connection's window have room, collects answers, and ends jobs on error, cancel and deadline.
//
// The runner uses no sockets: frames go to a Sink, and completions come back through `post`. It
// runs on the io thread; only tasks run elsewhere, and they share only a StopFlag with it.
#pragma once

#include "protocol/limits.h"
#include "server/ground/budget.h"
#include "server/ground/log.h"
#include "server/ground/metrics.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/coalescer.h"
#include "server/scheduling/dispatched_task.h"
#include "server/scheduling/fair_thread_pool.h"
#include "server/scheduling/inline_budget.h"
#include "server/scheduling/job.h"
#include "server/scheduling/peers.h"

#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <string>

namespace raynest::server {

/// Memory of a frame that waits or is kept, besides its bytes.
inline constexpr std::uint64_t waiting_frame_bytes = 256;

/// Receives the frames for a client; implemented by sessions and detached jobs.
class Sink {
public:
    virtual void send(protocol::Frame frame) = 0;
    /// Bytes passed to send() that have not been written to the socket yet.
    [[nodiscard]] virtual std::uint64_t backlog() const = 0;

protected:
    ~Sink() = default;
};

/// The parts of the daemon that all runners share; outlives them.
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

/// Runs jobs. Io thread only.
class Runner : public std::enable_shared_from_this<Runner> {
public:
    /// All jobs count for `principal`, in quotas and in the order of tasks.
    Runner(const JobContext& context, Sink& sink, std::string principal)
        : context_(context),
          sink_(&sink),
          principal_(std::move(principal)) {}

    /// Call before the first job, once the client is authenticated.
    void set_principal(std::string principal) { principal_ = std::move(principal); }
    /// Sets the credit that the client grants to each request at its start.
    void set_window(std::uint64_t bytes) { window_bytes_ = bytes; }

    /// True if a job of this request id is in flight.
    [[nodiscard]] bool knows(std::uint64_t id) const;
    /// Number of jobs in flight, including those whose memory is being freed.
    [[nodiscard]] std::size_t size() const { return jobs_.size() + leaving_; }

    /// Gives a request that waits before it starts a place among the jobs in flight: it costs memory
    /// and, once it goes on, time. Fails as start() does.
    Reply<Admission::Slot> enter_parked(std::uint16_t message_type, Clock::time_point deadline,
                                        std::function<void()> cancel);
    /// Starts a job. Reserves memory for the data that its client may send and for unread answers;
    /// paused peers give way if needed. Fails with QUOTA (of the principal; the conversation checks
    /// jobs_max), BUSY or RESOURCE_EXHAUSTED. Returns the job's number, unique in the daemon.
    Reply<std::uint64_t> start(std::uint64_t id, JobSubmission accepted);
    /// Returns the memory that covers `bytes` of bulk data on their way to a job; null if the job is
    /// not in flight, its input credit does not cover them, or memory is short for them, which ends
    /// the job. It is the job's own, and stays reserved after the job while the caller keeps it.
    [[nodiscard]] std::shared_ptr<Budget::Lease> admit(std::uint64_t id, std::uint64_t bytes);
    /// Passes bulk data to a job; drops them if the job has ended, which the client cannot know
    /// yet.
    void feed(protocol::Frame frame);
    /// Adds credit that the client granted to a job.
    void grant(std::uint64_t id, std::uint64_t bytes);
    void cancel(std::uint64_t id);
    void cancel_all();
    /// Ends a job with an error; does nothing for a job that has ended.
    void fail(std::uint64_t id, const protocol::Error& error);
    void fail_all(const protocol::Error& error);
    /// True if the job still needs its client: to send data, or to receive an error.
    [[nodiscard]] bool needs_client(std::uint64_t id) const;

    /// Starts tasks that waited for room in the sink. Call it after the sink's backlog shrank.
    void pump();
    /// Enforces deadlines and sends progress. Call it at next_tick().
    void tick(Clock::time_point now);
    [[nodiscard]] Clock::time_point next_tick() const;
    /// True if every job waits for its client to send data, grant credit or read.
    [[nodiscard]] bool waits_for_client() const;
    /// Bytes of --memory that the jobs and their answers have reserved.
    [[nodiscard]] std::uint64_t held_bytes() const;

    /// Stops all jobs with this error and sends nothing more, because the connection is gone. The
    /// message has at most 15 bytes, which need no memory of their own.
    void abandon(const protocol::Error& why = client_is_gone());
    [[nodiscard]] static protocol::Error client_is_gone() {
        return {Code::cancelled, "client is gone", 0};
    }

private:
    /// A submitted task.
    struct Outstanding {
        std::uint64_t reserved = 0;  ///< bytes of the job's credit
        const FairThreadPool* pool = nullptr;
        TryDequeue try_dequeue = {};
    };
    struct Active {
        Active(std::uint64_t request_id, std::unique_ptr<Job> work, Clock::time_point deadline)
            : id(request_id),
              job(std::move(work)),
              stop(deadline) {}
        const std::uint64_t id;
        std::unique_ptr<Job> job;  ///< null once finished, even if tasks still refer to this
        bool prepared = false;     ///< the job is greeted, or its greeting can be sent
        const RequestTag tag = RequestScope::current();  ///< for the log
        StopFlag stop;
        Admission::Slot slot;
        std::shared_ptr<Budget::Lease> input;  ///< for data that the client may send
        Priority priority = Priority::normal;
        Clock::time_point started;
        Clock::time_point next_progress;
        Clock::time_point stopped = Clock::time_point::max();  ///< max: it was not stopped
        std::optional<protocol::Error> error;                  ///< why the job ends early
        std::optional<Task> parked;      ///< task that waits for a thread or for room
        std::list<Outstanding> tasks;    ///< tasks that wait for a worker or run
        std::uint64_t credit = 0;        ///< bytes that the daemon may still send
        std::uint64_t reserved = 0;      ///< part of `credit` reserved for running tasks
        std::uint64_t input_credit = 0;  ///< bytes that the client may still send
        std::uint64_t returned = 0;      ///< freed input bytes that are not yet granted again
    };
    using ActivePointer = std::shared_ptr<Active>;

    ActivePointer find(std::uint64_t id) const;
    /// Admits a job; closes a paused peer for it if needed.
    Reply<Admission::Slot> enter(JobRecord record);
    /// Sends the first frames of a job that is prepared.
    void greet(Active& active);
    /// Calls `step`; fails the job if memory is short, as in a task.
    template <class Step>
    void guarded(Active& active, Step step);
    void pump(const ActivePointer& active);
    [[nodiscard]] FairThreadPool& pool_of(const Task& task) const {
        return task.pool != nullptr ? *task.pool : context_.compute;
    }
    /// True if there is a thread for the task and room for its answer.
    [[nodiscard]] bool may_start(const Active& active, const Task& task) const;
    /// Runs a task on the io thread. Returns false if InlineBudget has no room for it or the task
    /// exceeds its time limit.
    bool run_inline(Active& active, const Task& task);
    void submit(const ActivePointer& active, Task task);
    void take_answer(Active& active, Reply<Frames> reply);
    void task_ended(const ActivePointer& active, std::list<Outstanding>::iterator task,
                    Reply<Frames> reply);
    /// Removes a task that has ended or was dropped, and releases its reservations.
    void forget(Active& active, std::list<Outstanding>::iterator task);
    void return_input(Active& active, std::uint64_t bytes);
    /// Shrinks `answers_` to the sink's backlog if no job is in flight.
    void shrink_answers();
    void stop(Active& active, protocol::Error error);
    void finish(const ActivePointer& active);
    /// Counts and logs a job that has ended, and returns the last frames for its client.
    Frames conclude(Active& active);
    /// Destroys a job that holds much memory on a compute thread, then calls leave(). Returns false
    /// if memory is short for that.
    bool destroy_elsewhere(const ActivePointer& active, Frames& last);
    /// Sends the last frames of a job and frees its place.
    void leave(Active& active, Frames last);

    const JobContext& context_;
    Sink* sink_;  ///< null once abandoned
    std::string principal_;
    std::list<ActivePointer> jobs_;
    std::size_t leaving_ = 0;  ///< jobs that a compute thread destroys
    int works_ = 0;            ///< WorksForPeer
    std::uint64_t window_bytes_ = 0;
    std::uint64_t in_flight_bytes_ = 0;  ///< reserved by running tasks of all jobs
    /// Memory for the answers of running tasks and for unsent frames, at most a window. It outlives
    /// the jobs, because an unread answer takes memory after its job has ended.
    Budget::Lease answers_;
};

}  // namespace raynest::server
