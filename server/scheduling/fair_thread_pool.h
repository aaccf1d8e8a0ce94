// A fixed set of threads that run tasks, shared fairly by the principals whose tasks wait.
//
//   turns:  uid:1000 ──► 127.0.0.1 ──► ...      the first principal runs one task, then goes last
//             │ high 7                          within a principal: by priority, then in order
//             │ normal 3, 5, 8
//
// Principals take turns, however many connections and jobs they have: a principal with a single job
// waits for one task of each other principal, never for all their tasks. After a long task its
// principal skips a turn for each `slice` that the task took, while others wait. So principals
// share time, not numbers of tasks. Jobs occupy no thread between chunks.
//
// A task may take much longer than usual, e.g. if its rays meet most of a scene. Spare threads then
// replace the threads that such tasks occupy, so that waiting tasks still get the full number of
// threads; the operating system shares the processor among all. One principal can use at most half
// of the spare threads. A principal that has no thread, while tasks of others occupy all of them
// for longer than two turns, gets a spare one at once; there are no more of these than regular
// threads.
//
// Tasks that wait for processes occupy their threads for minutes, and turns do not help those who
// come meanwhile. Such a pool has places: a principal has at most `places_each` of its threads, and
// never the last one if it has another (fair_share.h).
#pragma once

#include "server/scheduling/job.h"

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace raynest::server {

/// Runs the tasks of principals in turn. Thread-safe.
class FairThreadPool {
public:
    /// The time that a task costs its principal: CPU time, which does not depend on the load of the
    /// machine, or wall-clock time, for tasks that wait for processes or devices.
    enum class Time { processor, clock };

    /// Throws std::system_error if the system has no threads left. With 0 threads, tasks run in
    /// run_one(). Up to `spares` more threads replace those that long tasks occupy. A principal
    /// runs at most `places_each` tasks at a time; 0: as many as it gets turns.
    explicit FairThreadPool(unsigned threads, Time charged = Time::processor, unsigned spares = 0,
                            unsigned places_each = 0);
    /// Drops tasks that have not started; waits for running ones.
    ~FairThreadPool();
    FairThreadPool(const FairThreadPool&) = delete;

    /// Queues a task, which must not throw. The queue is unbounded: callers limit their tasks in
    /// flight. Returns the task's number, for change().
    std::uint64_t submit(const std::string& principal, Priority priority,
                         std::function<void()> task);

    /// Calls `change` if the task has not started, and keeps it from starting meanwhile; drops the
    /// task if `change` returns false. Returns false, without a call, if the task has started.
    bool change(const std::string& principal, std::uint64_t number,
                const std::function<bool()>& change);

    /// Runs the next task on the calling thread; false if none waits.
    bool run_one() noexcept;

    /// Time that counts as one turn: that of a usual chunk.
    static constexpr std::chrono::milliseconds slice{4};
    /// Time after which a task counts as long.
    static constexpr std::chrono::milliseconds patience{250};
    /// The same, while a principal has no thread. The watch looks at this interval.
    static constexpr std::chrono::milliseconds turn_patience = 2 * slice;

    [[nodiscard]] std::size_t threads() const { return regulars_.size(); }
    /// Returns for how long the longest of the running tasks has run; 0 if none runs.
    [[nodiscard]] std::chrono::nanoseconds longest_task();

private:
    struct Waiting {
        Priority priority;
        std::uint64_t number;  ///< in order of submission
        std::function<void()> task;
    };
    struct Account {
        std::vector<Waiting> queue;  ///< a heap; the next task to run is in front
        std::size_t running = 0;
        std::int64_t debt = 0;  ///< turns to skip
    };
    using Accounts = std::map<std::string, Account>;
    using Turns = std::list<Accounts::iterator>;
    struct Taken {
        Accounts::iterator account;
        std::function<void()> task;
    };
    /// A thread and the state of its task.
    struct WorkerThread {
        Clock::time_point since = Clock::time_point::max();  ///< start of its task; max: idle
        bool over = false;         ///< true: a spare thread that has ended
        std::jthread thread = {};  ///< joined before this is destroyed
    };
    static bool later(const Waiting& a, const Waiting& b);
    void stop();
    void run(WorkerThread& self);
    /// True if the principal may have one more thread.
    [[nodiscard]] bool has_place(const Account& account) const;
    /// Returns the principal whose task a regular thread takes next; the end if none may be taken.
    Turns::iterator next_in_turn();
    /// Returns the principal whose task a spare thread takes next: the one with the fewest running
    /// tasks. Returns the end if that one has its share of threads already.
    Turns::iterator least_served();
    /// Removes the next task of a principal; `worker` is the calling thread's.
    Taken take(Turns::iterator turn, WorkerThread& worker);
    void run_taken(Taken taken, WorkerThread& worker);
    /// Number of threads whose task has run for longer than this.
    [[nodiscard]] std::size_t held(std::chrono::milliseconds time) const;
    /// True if one more spare thread is to start.
    [[nodiscard]] bool needs_spare();
    /// Starts and removes spare threads; runs on a thread of its own.
    void watch();
    /// Returns false if the system has no memory or thread for it.
    bool start_spare();
    void run_spare(WorkerThread& self);
    /// Returns the principal whose task a spare thread takes next; the end if a regular one is to
    /// take it.
    Turns::iterator next_for_spare();

    std::mutex mutex_;
    std::condition_variable wake_;        ///< wakes regular threads
    std::condition_variable wake_spare_;  ///< wakes spare threads
    Accounts accounts_;  ///< principals with waiting or running tasks, or with debt
    Turns turns_;        ///< principals with waiting tasks, each once
    std::uint64_t submitted_ = 0;
    bool stopping_ = false;
    const Time charged_;
    const std::size_t spares_max_;
    const std::size_t places_each_;  ///< 0: no limit
    std::size_t running_ = 0;        ///< tasks
    std::condition_variable alarm_;  ///< wakes the thread of watch()
    bool resting_ = false;           ///< watch() sleeps until the next task is submitted
    bool alarmed_ = false;           ///< a principal without a thread has submitted a task
    std::vector<WorkerThread> regulars_;
    std::list<WorkerThread> spares_;
    std::thread watch_;
};

}  // namespace raynest::server
