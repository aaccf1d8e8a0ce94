// Bounds how often an event is logged that strangers cause as fast as they can connect.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <utility>

namespace raynest::server {

/// Lets a few lines per second through and counts the rest. Io thread only.
class LineLimit {
public:
    using Time = std::chrono::steady_clock::time_point;
    static constexpr unsigned lines_max = 5;  ///< per second

    /// True if a line may be written; false counts it as left out.
    bool admit(Time now) {
        if (now - begin_ >= period) {
            begin_ = now;
            lines_ = 0;
        }
        if (lines_ < lines_max) {
            ++lines_;
            return true;
        }
        ++left_out_;
        return false;
    }
    /// Returns the number of lines left out since the last call; 0 while their second goes on.
    std::uint64_t take_left_out(Time now) {
        return now - begin_ < period ? 0 : std::exchange(left_out_, 0);
    }

private:
    static constexpr std::chrono::seconds period{1};
    Time begin_ = Time() - period;
    unsigned lines_ = 0;
    std::uint64_t left_out_ = 0;
};

/// Logs `handshake_failed`, within a LineLimit.
void log_failed_handshake(const std::string& peer, const std::string& why);
/// Logs how many of those lines were left out, if any. Call it now and then.
void log_left_out_handshakes();

}  // namespace raynest::server
