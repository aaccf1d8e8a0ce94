// How a task learns that it shall stop.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>

namespace raynest::server {

using Clock = std::chrono::steady_clock;

/// Returns the deadline of what may take `milliseconds` from `now`; 0: as long as it takes.
[[nodiscard]] inline Clock::time_point deadline_after(Clock::time_point now,
                                                      std::uint32_t milliseconds) {
    return milliseconds == 0 ? Clock::time_point::max()
                             : now + std::chrono::milliseconds(milliseconds);
}
/// The inverse, at least 1 for a deadline.
[[nodiscard]] inline std::uint32_t milliseconds_until(Clock::time_point deadline,
                                                      Clock::time_point now) {
    if (deadline == Clock::time_point::max()) return 0;
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - now).count();
    return static_cast<std::uint32_t>(std::max<std::int64_t>(left, 1));
}

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
