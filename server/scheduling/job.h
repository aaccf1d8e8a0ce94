// The interface of jobs: a job is a sequence of tasks, each of which traces at most one chunk.
//
// A job is a state machine on the io thread. next() returns a task, which runs on a worker thread
// and returns frames. Between tasks a job occupies no thread: the job of a slow reader waits and
// costs only its own memory.
//
//   prepare() -> task ──► greeting()
//      next() -> task ──worker──► frames ──► outbox     feed(frame): rays and pieces of files
//         ▲                          │                  progress(): a few times a second
//         └────── ended() ◄──────────┘                  farewell(): the last frames
//
// The io thread serves all connections, so nothing that it calls may take longer for a larger
// request or scene: tasks allocate, fill, sum up and encode. A job that holds much memory is also
// destroyed on a worker thread.
#pragma once

#include "protocol/frame.h"
#include "server/ground/errors.h"
#include "server/ground/stop.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace raynest::server {

using Frames = std::vector<protocol::Frame>;

class FairThreadPool;

/// A task of few rays that may be traced together with others in one call.
class MergeableTask {
public:
    MergeableTask() = default;
    MergeableTask(const MergeableTask&) = delete;
    MergeableTask& operator=(const MergeableTask&) = delete;
    virtual ~MergeableTask() = default;

    /// Returns the frames that `task` would return if it ran alone; its rays begin at `first_row`
    /// of the traced ones.
    using AnswerRows =
        std::function<Reply<Frames>(const MergeableTask& task, std::uint64_t first_row)>;

    [[nodiscard]] virtual std::uint64_t rays() const = 0;
    /// True if both tasks can share a call: same scene, kernel and parameters.
    [[nodiscard]] virtual bool same_as(const MergeableTask& other) const = 0;
    /// Traces the rays of all tasks, each same_as() this one. If it fails, run each alone. Any
    /// thread.
    [[nodiscard]] virtual Reply<AnswerRows> trace(std::span<const MergeableTask* const> all,
                                                  const Stop& stop) const = 0;
};

/// A unit of work of a job.
struct Task {
    /// Does the work; may be called again after a failure. The result is dropped once `stop` is
    /// requested.
    std::function<Reply<Frames>(const Stop& stop)> run;
    /// Maximum bulk bytes of the result; reserved from the credit before the task runs.
    std::uint64_t reply_bytes_max = 0;
    /// The pool that runs the task; null: the compute threads.
    FairThreadPool* pool = nullptr;
    /// Number of rays or hits of a task that takes less time than a thread switch; else 0. The io
    /// thread runs such a task at once if no other task of the job runs and InlineBudget allows it.
    std::uint64_t inline_cost = 0;
    /// Not null if the task may run together with others (coalescer.h).
    std::shared_ptr<const MergeableTask> mergeable = {};
};

struct Progress {
    std::uint64_t done = 0;
    std::uint64_t total = 0;  ///< 0: unknown
    const char* stage = "";
    std::uint32_t samples = 0;  ///< a film's smallest number per pixel so far
    float noise = 0;            ///< a film's estimated relative error so far; 0: unknown
    std::uint64_t left_ms = 0;  ///< until the end, as estimated; 0: unknown
};

/// A job. Its functions are called on the io thread; its tasks run on other threads, in any order.
/// Until ended() is called for a task, it may use members that the io thread does not use.
class Job {
public:
    Job() = default;
    Job(const Job&) = delete;
    Job& operator=(const Job&) = delete;
    virtual ~Job() = default;

    /// Returns a task that makes what grows with the request or the scene; nothing if there is no
    /// such thing. Its error ends the job before greeting(). Until it
    /// has ended, only feed(), needs_input(), held_bytes() and progress() are called.
    virtual std::optional<Task> prepare() { return std::nullopt; }
    /// Returns the first frames of the answer.
    virtual Frames greeting() { return {}; }
    /// Returns the next task; nothing if the job waits for input or for its running tasks.
    virtual std::optional<Task> next() = 0;
    /// Called after a task succeeded and its frames were sent. An error ends the job.
    virtual Reply<void> ended() { return {}; }
    /// True if next() will return no further task, even if more is fed.
    [[nodiscard]] virtual bool finished() const = 0;
    /// Returns the last frames of the answer, after all tasks succeeded. They have no bulk part.
    virtual Frames farewell() = 0;
    /// True if the client must send more data before the job can end.
    [[nodiscard]] virtual bool needs_input() const { return false; }
    /// Bytes of --memory that the job has reserved itself, besides its windows. A job that holds
    /// many is destroyed on a worker thread.
    [[nodiscard]] virtual std::uint64_t held_bytes() const { return 0; }
    /// Takes bulk data from the client. Returns the bytes that were freed at once.
    virtual Reply<std::uint64_t> feed(protocol::Frame frame);
    /// Returns the bulk bytes of fed frames that were freed since the last call.
    virtual std::uint64_t take_freed_input() { return 0; }
    [[nodiscard]] virtual std::optional<Progress> progress() const { return std::nullopt; }
};

/// Order of tasks among the jobs of one principal.
enum class Priority { low, normal, high };

/// A job and its description, submitted by a handler.
struct JobSubmission {
    std::unique_ptr<Job> job;
    std::uint32_t deadline_ms = 0;  ///< from now; 0: none
    Priority priority = Priority::normal;
    std::uint64_t rays = 0;          ///< rays that the job will trace
    std::uint64_t input_bytes = 0;   ///< maximum bulk bytes that the client will send
    std::uint64_t answer_bytes = 0;  ///< maximum bulk bytes of the answer
    std::string kind;                ///< for listings and the log: query, render, ...
    std::string detail;              ///< kind or reducer of a query; else empty
    std::string worker = "cpu";
    std::string scene;
    bool detach = false;             ///< true: the job outlives its connection
    std::uint64_t result_bytes = 0;  ///< detached: bytes to reserve for the answer
    std::string advice = "ask for fewer rays or fields";  ///< advice on a smaller answer
};

}  // namespace raynest::server
