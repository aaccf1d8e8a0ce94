// What the io thread does between two looks at its sockets, for the log: at level debug, each turn
// that takes long is a line. tests/bench/service/turns.py reads them.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <utility>

namespace raynest::server {

/// Queues a function for the io thread. Thread-safe.
using Post = std::function<void(std::function<void()>)>;

/// Time for which one that has much to do keeps the io thread before others have a turn. Shorter
/// ones cost throughput: small queries of a turn are traced together.
inline constexpr std::chrono::microseconds turn_time{200};

/// Calls `step` until it returns false, for the time of a turn. What is left follows in turns that
/// `post` queues.
inline void in_turns(const Post& post, std::function<bool()> step) {
    const auto end = std::chrono::steady_clock::now() + turn_time;
    while (step())
        if (std::chrono::steady_clock::now() >= end)
            return post(
                [post, step = std::move(step)]() mutable { in_turns(post, std::move(step)); });
}

/// The present turn of the io thread. Io thread only.
class IoTurn {
public:
    /// Says what the turn does, as a literal. The last call of a turn counts.
    static void does(const char* what) { what_ = what; }
    /// Says which message the turn handles.
    static void handles(std::uint16_t message_type) { message_type_ = message_type; }

    /// Runs turns until one returns false, and logs those of 0.25 ms of CPU time and more. The
    /// clock costs 0.5 us a turn.
    static void run_and_log(const std::function<bool()>& turn);

private:
    static inline const char* what_ = "";
    static inline std::uint16_t message_type_ = 0;
};

}  // namespace raynest::server
