// A fixed set of threads that run tasks, shared fairly by the principals whose tasks wait.
//
//   turns:  uid:1000 ──► 127.0.0.1 ──► ...      the first in turn gives one task, then goes last
//             │ high 7                          within a principal: by priority, then by order
//             │ normal 3, 5, 8
//
// A principal is who asks, however many connections and jobs that takes: one with a single job
// waits for one task of each other, never for all of them. Who had a long task sits out a turn for
// each slice of time that it took, while others wait: the share is of time, not of tasks. Jobs hold
// no thread: a job submits one chunk at a time and is asked again when it ended.
//
// A task may take much longer than its kind usually does: rays that meet all that a scene holds.
// Spare threads take the place of those that such tasks hold, so that as many as ever run what
// waits; the system shares the processor among them all. Half of the spare threads are out of reach
// for any one principal.
#pragma once

#include "server/jobs/job.h"

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

/// Thread-safe.
class FairThreadPool {
public:
    /// Measures what a task costs its principal: by the processor, where what the rest of the
    /// machine does is nobody's debt; or by the clock, where tasks wait for something else.
    enum class Time { processor, clock };

    /// Throws std::system_error when the system has no threads left. With 0 of them tasks wait for
    /// run_one(). Up to `spares` threads more, in the place of those that are held.
    explicit FairThreadPool(unsigned threads, Time charged = Time::processor, unsigned spares = 0);
    /// Drops what has not started, waits for what runs.
    ~FairThreadPool();
    FairThreadPool(const FairThreadPool&) = delete;

    /// The task must not throw. Unbounded by itself: callers bound what they have in flight. Gives
    /// the number by which it can be changed.
    std::uint64_t submit(const std::string& principal, Priority priority,
                         std::function<void()> task);

    /// While a task waits nobody runs it: `change` then says whether there is anything left of it
    /// to do, and without it is dropped. False, and nothing happens, once it was begun.
    bool change(const std::string& principal, std::uint64_t number,
                const std::function<bool()>& change);

    /// Runs the next task here; false when none waits.
    bool run_one() noexcept;

    /// So much time is one turn: the time of a usual chunk.
    static constexpr std::chrono::milliseconds slice{4};
    /// A task that takes longer holds its thread; that is seen after as long again, at most.
    static constexpr std::chrono::milliseconds patience{250};

    [[nodiscard]] std::size_t threads() const { return regulars_.size(); }

private:
    struct Waiting {
        Priority priority;
        std::uint64_t number;  ///< of its submission
        std::function<void()> task;
    };
    struct Account {
        std::vector<Waiting> queue;  ///< a heap: what is to run next lies in front
        std::size_t running = 0;
        std::int64_t debt = 0;  ///< turns to sit out
    };
    using Accounts = std::map<std::string, Account>;
    using Turns = std::list<Accounts::iterator>;
    struct Taken {
        Accounts::iterator account;
        std::function<void()> task;
    };
    /// A thread and what it is at.
    struct WorkerThread {
        Clock::time_point since = Clock::time_point::max();  ///< it runs its task; max: it has none
        bool over = false;                                   ///< a spare one that has ended
        std::jthread thread = {};                            ///< joined before its seat goes
    };
    static bool later(const Waiting& a, const Waiting& b);
    void stop();
    void run(WorkerThread& self);
    /// The principal whose task a thread takes next; `turns_` must not be empty.
    Turns::iterator next_in_turn();
    /// The same for a spare thread: of whom least runs, if that is little enough; else the end.
    Turns::iterator least_served();
    /// `seat` is that of the thread that asks.
    Taken take(Turns::iterator turn, WorkerThread& seat);
    void run_taken(Taken taken, WorkerThread& seat);
    /// Threads that have been at one task for longer than `patience`.
    [[nodiscard]] std::size_t held() const;
    void watch();
    /// False when the system has no room for one.
    bool start_spare();
    void run_spare(WorkerThread& self);

    std::mutex mutex_;
    std::condition_variable wake_;
    Accounts accounts_;  ///< of principals with tasks that wait or run, or debt
    Turns turns_;        ///< those with tasks that wait, each once
    std::uint64_t submitted_ = 0;
    bool stopping_ = false;
    const Time charged_;
    const std::size_t spares_max_;
    std::condition_variable alarm_;  ///< wakes the thread that watches
    bool resting_ = false;           ///< nothing to watch until the next task comes
    std::vector<WorkerThread> regulars_;
    std::list<WorkerThread> spares_;
    std::thread watch_;
};

}  // namespace raynest::server
