// A job as the runner sees it: a sequence of tasks, each small enough to be one chunk.
//
// A job is a state machine on the io thread. next() hands out a piece of work; the work runs on a
// worker thread and gives back frames. Between tasks a job holds no thread: whoever reads slowly
// leaves its job parked, at the cost of the job's own memory.
//
//   next() -> task ──worker──► frames ──► outbox        feed(frame): rays and pieces of files
//      ▲                          │                     progress(): a few times a second
//      └────── ended() ◄──────────┘                     farewell(): the last frames
#pragma once

#include "protocol/frame.h"
#include "server/errors.h"

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {

using Clock = std::chrono::steady_clock;

/// Whether work is to be given up. Asked often, by the thread that works.
class Stop {
public:
    Stop() = default;
    Stop(const Stop&) = delete;
    [[nodiscard]] virtual bool requested() const noexcept = 0;

protected:
    ~Stop() = default;
};

/// Shared by a job and its tasks; thread-safe. At the deadline the io thread requests it, so that
/// tasks need no clock.
class StopFlag final : public Stop {
public:
    explicit StopFlag(Clock::time_point deadline) : deadline_(deadline) {}
    void request() { requested_.store(true, std::memory_order_relaxed); }
    [[nodiscard]] bool requested() const noexcept override {
        return requested_.load(std::memory_order_relaxed);
    }
    [[nodiscard]] bool expired() const { return Clock::now() >= deadline_; }
    [[nodiscard]] Clock::time_point deadline() const { return deadline_; }

private:
    std::atomic<bool> requested_{false};
    const Clock::time_point deadline_;
};

using Frames = std::vector<protocol::Frame>;

class FairThreadPool;

/// A task of few rays that may be traced in one call together with others.
class MergeableTask {
public:
    MergeableTask() = default;
    MergeableTask(const MergeableTask&) = delete;
    MergeableTask& operator=(const MergeableTask&) = delete;
    virtual ~MergeableTask() = default;

    /// Gives what a task by itself would have given, out of the traced rays from `first_row` on.
    using AnswerRows =
        std::function<Reply<Frames>(const MergeableTask& task, std::uint64_t first_row)>;

    [[nodiscard]] virtual std::uint64_t rays() const = 0;
    /// Does the other ask the same of the same scene?
    [[nodiscard]] virtual bool same_as(const MergeableTask& other) const = 0;
    /// Any thread: traces the rays of all, which ask the same as this one. On failure each is to
    /// run by itself.
    [[nodiscard]] virtual Reply<AnswerRows> trace(std::span<const MergeableTask* const> all,
                                                  const Stop& stop) const = 0;
};

struct Task {
    /// What it gives once `stop` is requested is dropped. It may be run again after it failed.
    std::function<Reply<Frames>(const Stop& stop)> run;
    /// Bulk bytes of the answer at most: reserved before it runs.
    std::uint64_t reply_bytes_max = 0;
    /// The threads that run it; null: those that compute.
    FairThreadPool* pool = nullptr;
    /// Rays or hits of a task that is shorter than the way to a thread and back, else 0: the io
    /// thread runs it at once, unless a task of its job is under way or its budget is used up.
    std::uint64_t inline_cost = 0;
    /// Not null where it may run together with others (coalescer.h).
    std::shared_ptr<const MergeableTask> mergeable = {};
};

struct Progress {
    std::uint64_t done = 0;
    std::uint64_t total = 0;  ///< 0: not known
    const char* stage = "";
};

/// All functions are called on the io thread, tasks run elsewhere and in any order; a task may
/// touch what the io thread does not, until ended() was called for it.
class Job {
public:
    Job() = default;
    Job(const Job&) = delete;
    Job& operator=(const Job&) = delete;
    virtual ~Job() = default;

    /// The frames that the client reads first.
    virtual Frames greeting() { return {}; }
    /// The next task; nothing when the job waits for input or for its running tasks.
    virtual std::optional<Task> next() = 0;
    /// A task ended well; its frames are on their way. An error here ends the job.
    virtual Reply<void> ended() { return {}; }
    /// No further task will come, whatever is fed.
    [[nodiscard]] virtual bool finished() const = 0;
    /// What the client reads last, after all tasks ended well. No bulk.
    virtual Frames farewell() = 0;
    /// Must its client send more before it can end?
    [[nodiscard]] virtual bool needs_input() const { return false; }
    /// Bytes of --memory that it has reserved itself, beside its windows.
    [[nodiscard]] virtual std::uint64_t held_bytes() const { return 0; }
    /// Bulk data for this job; gives the bytes that are free again at once.
    virtual Reply<std::uint64_t> feed(protocol::Frame frame);
    /// Bulk bytes of fed frames that became free since it was last asked.
    virtual std::uint64_t take_freed_input() { return 0; }
    [[nodiscard]] virtual std::optional<Progress> progress() const { return std::nullopt; }
};

/// Among the jobs of one principal: the higher one's tasks go first.
enum class Priority { low, normal, high };

/// A job, as a handler submits it.
struct JobSubmission {
    std::unique_ptr<Job> job;
    std::uint32_t deadline_ms = 0;  ///< from now; 0: none
    Priority priority = Priority::normal;
    std::uint64_t rays = 0;          ///< that it will trace
    std::uint64_t input_bytes = 0;   ///< bulk bytes that the client will feed, at most
    std::uint64_t answer_bytes = 0;  ///< bulk bytes that it will answer, at most
    std::string kind;                ///< for people: query, render, ...
    std::string detail;              ///< of a query: its kind
    std::string worker = "cpu";
    std::string scene;
    bool detach = false;             ///< it outlives its connection
    std::uint64_t result_bytes = 0;  ///< of a detached one: room to reserve for its answer
    std::string less = "ask for fewer rays or fields";  ///< advice on a smaller answer
};

}  // namespace raynest::server
