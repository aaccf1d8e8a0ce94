// Limits how much the io thread traces itself between two polls of its sockets.
//
// A small request is answered soonest on the thread that read it. If many arrive at once, those
// beyond the budget of a turn go to workers, where they run in parallel and delay no connection.
// Tasks that take longer than expected go to workers too.
#pragma once

#include "server/scheduling/job.h"

#include <chrono>
#include <cstdint>
#include <functional>

namespace raynest::server {

/// Maximum rays, or hits, per turn. A request of this size is answered before a worker wakes up.
inline constexpr std::uint64_t inline_cost_max = 64;
/// Time limit of an inline task, twenty times its usual duration.
inline constexpr std::chrono::milliseconds inline_time_max{1};

/// Stops an inline task by time; no other thread could stop it.
class InlineStop final : public Stop {
public:
    [[nodiscard]] bool requested() const noexcept override { return Clock::now() >= end_; }

private:
    const Clock::time_point end_ = Clock::now() + inline_time_max;
};

/// Rays, or hits, that the io thread may still trace in this turn. Io thread only; must outlive the
/// functions that it posts.
class InlineBudget {
public:
    InlineBudget() = default;
    InlineBudget(const InlineBudget&) = delete;

    /// Reserves part of the turn's budget; false if there is too little left. `post` queues the end
    /// of the turn after all handlers that are ready.
    bool enter(std::uint64_t hits, const std::function<void(std::function<void()>)>& post) {
        if (hits > inline_cost_max - taken_) return false;
        if (taken_ == 0) post([this] { taken_ = 0; });
        taken_ += hits;
        return true;
    }

    /// Uses up the budget of this turn.
    void end() { taken_ = inline_cost_max; }

private:
    std::uint64_t taken_ = 0;
};

}  // namespace raynest::server
