// Requests that wait for something that is under way.
#pragma once

#include "server/ground/errors.h"
#include "server/ground/io_turn.h"

#include <algorithm>
#include <cstddef>
#include <deque>
#include <functional>
#include <memory>
#include <utility>

namespace raynest::server {

/// Those who wait, first come, first served. Whoever has expired takes no room for long: a place
/// that is added when they are twice as many as waited last frees those of the expired.
/// Io thread only.
class Waiters {
public:
    /// Gets the error of what they wait for, or nothing.
    using Awake = std::function<void(const Reply<void>&)>;

    /// Calls it later, unless it has expired. The cost does not grow with those who wait, on
    /// average.
    void add(std::weak_ptr<Awake> awake) {
        if (waiting_.size() >= drop_at_) {
            std::erase_if(waiting_, [](const auto& each) { return each.expired(); });
            drop_at_ = std::max(places_least, 2 * waiting_.size());
        }
        waiting_.push_back(std::move(awake));
    }
    /// Calls all who have come until now, in turns of the io thread. Holds `kept` until all are
    /// called.
    void wake_all(Reply<void> result, const Post& post, std::shared_ptr<const void> kept = {}) {
        const auto all = std::make_shared<Waiters>();
        all->waiting_.swap(waiting_);
        in_turns(post, [all, result = std::move(result), kept = std::move(kept)] {
            IoTurn::does("those who wait");
            all->wake_first(result);
            return !all->empty();
        });
    }
    /// Calls the first one.
    void wake_first(const Reply<void>& result) {
        while (!waiting_.empty()) {
            const auto awake = waiting_.front().lock();
            waiting_.pop_front();
            if (awake) return (*awake)(result);
        }
    }

    /// True if nobody waits any more.
    [[nodiscard]] bool all_expired() const {
        return std::ranges::all_of(waiting_, [](const auto& each) { return each.expired(); });
    }
    [[nodiscard]] bool empty() const { return waiting_.empty(); }
    /// Number of places, those of the expired included.
    [[nodiscard]] std::size_t size() const { return waiting_.size(); }

private:
    static constexpr std::size_t places_least = 16;
    std::deque<std::weak_ptr<Awake>> waiting_;
    std::size_t drop_at_ = places_least;
};

}  // namespace raynest::server
