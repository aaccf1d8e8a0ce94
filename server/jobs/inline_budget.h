// How much the io thread traces itself between two looks at its sockets.
//
// One small request is answered soonest where it was read. Of many that come at once, those beyond
// a turn's share go to the workers, where they run at the same time and keep no connection waiting.
// So does what takes longer than its few rays made expect.
#pragma once

#include "server/jobs/job.h"

#include <chrono>
#include <cstdint>
#include <functional>

namespace raynest::server {

/// A request of so few rays and hits is answered sooner than a worker would wake up for it.
inline constexpr std::uint64_t inline_cost_max = 64;
/// Twenty times what they usually take.
inline constexpr std::chrono::milliseconds inline_time_max{1};

/// Ends a task on the io thread, where nobody else can stop it.
class InlineStop final : public Stop {
public:
    [[nodiscard]] bool requested() const noexcept override { return Clock::now() >= end_; }

private:
    const Clock::time_point end_ = Clock::now() + inline_time_max;
};

/// Io thread only; must outlive what it posts.
class InlineBudget {
public:
    InlineBudget() = default;
    InlineBudget(const InlineBudget&) = delete;

    /// May a task of so many rays, or hits, be answered in this turn? `post` puts the end of the
    /// turn behind whatever is ready to be handled now.
    bool enter(std::uint64_t hits, const std::function<void(std::function<void()>)>& post) {
        if (hits > inline_cost_max - taken_) return false;
        if (taken_ == 0) post([this] { taken_ = 0; });
        taken_ += hits;
        return true;
    }

    /// Nothing more in this turn.
    void end() { taken_ = inline_cost_max; }

private:
    std::uint64_t taken_ = 0;
};

}  // namespace raynest::server
