// A fixed set of threads that run tasks in the order they were submitted.
//
// Jobs never hold a thread: a job submits one chunk at a time and is asked again when it ended, so
// the first-in first-out queue is the fair share between jobs.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <mutex>
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
    void submit(std::function<void()> task);

    /// Runs the next task here; false when none waits.
    bool run_one() noexcept;

    [[nodiscard]] std::size_t threads() const { return threads_.size(); }

private:
    void run();

    std::mutex mutex_;
    std::condition_variable wake_;
    std::deque<std::function<void()>> tasks_;
    bool stopping_ = false;
    std::vector<std::thread> threads_;
};

}  // namespace raynest::server
