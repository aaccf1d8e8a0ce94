// How a task learns that it shall stop.
#pragma once

#include <atomic>
#include <chrono>

namespace raynest::server {

using Clock = std::chrono::steady_clock;

/// Tells a running task whether to stop. Tasks ask often, so requested() must be cheap.
class Stop {
public:
    Stop() = default;
    Stop(const Stop&) = delete;
    [[nodiscard]] virtual bool requested() const noexcept = 0;

protected:
    ~Stop() = default;
};

/// Stops a job and its tasks. The io thread requests the stop at the deadline, so that tasks need
/// not read the clock. Thread-safe.
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

}  // namespace raynest::server
