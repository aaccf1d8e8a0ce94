// Counts what a well-made peer does rarely, so that one that does little else can be sent away.
#pragma once

#include <chrono>

namespace raynest::server {

class MinuteLimit {
public:
    using Clock = std::chrono::steady_clock;

    /// More than `most` in a minute are too many.
    explicit MinuteLimit(unsigned most) : most_(most) {}

    void count(Clock::time_point now) noexcept {
        if (now - began_ > std::chrono::minutes(1)) {
            began_ = now;
            count_ = 0;
        }
        ++count_;
    }
    [[nodiscard]] bool is_over() const { return count_ > most_; }
    [[nodiscard]] unsigned most() const { return most_; }

private:
    const unsigned most_;
    unsigned count_ = 0;
    Clock::time_point began_;  ///< when the first that counts came
};

}  // namespace raynest::server
