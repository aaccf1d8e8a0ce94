// A fixed set of threads that run tasks, shared fairly by the principals whose tasks wait.
//
//   turns:  uid:1000 ──► 127.0.0.1 ──► ...      the first in turn gives one task, then goes last
//             │ high 7                          within a principal: by priority, then by order
//             │ normal 3, 5, 8
//
// A principal is who asks, however many connections and jobs that takes: one with a single job
// waits for one task of each other, never for all of them. Jobs hold no thread: a job submits one
// chunk at a time and is asked again when it ended.
#pragma once

#include "server/jobs/job.h"

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
class Workers {
public:
    /// Throws std::system_error when the system has no threads left. With 0 of them tasks wait for
    /// run_one().
    explicit Workers(unsigned threads);
    /// Drops what has not started, waits for what runs.
    ~Workers();
    Workers(const Workers&) = delete;

    /// The task must not throw. Unbounded by itself: callers bound what they have in flight.
    void submit(const std::string& principal, Priority priority, std::function<void()> task);

    /// Runs the next task here; false when none waits.
    bool run_one() noexcept;

    [[nodiscard]] std::size_t threads() const { return threads_.size(); }

private:
    struct Waiting {
        Priority priority;
        std::uint64_t number;  ///< of its submission
        std::function<void()> task;
    };
    /// A heap: what is to run next lies in front.
    using Queue = std::vector<Waiting>;
    static bool later(const Waiting& a, const Waiting& b);
    void run();
    std::function<void()> take();

    std::mutex mutex_;
    std::condition_variable wake_;
    std::map<std::string, Queue> queues_;  ///< of principals that have tasks waiting
    std::list<std::map<std::string, Queue>::iterator> turns_;  ///< each of them once
    std::uint64_t submitted_ = 0;
    bool stopping_ = false;
    std::vector<std::thread> threads_;
};

}  // namespace raynest::server
