// The bytes per second of each principal: all its connections together send, and receive, no more
// than its quota second_bytes.
//
// Bytes are counted after they went through: a connection that has sent more than its principal's
// share waits before it sends again. So no frame is cut, and a message of any size gets through.
#pragma once

#include "server/scheduling/job.h"
#include "server/security/quotas.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

namespace raynest::server {

/// Io thread only.
class Bandwidth {
public:
    enum class Direction { send, receive };

    explicit Bandwidth(const Quotas& quotas) : quotas_(quotas) {}
    Bandwidth(const Bandwidth&) = delete;

    /// Counts bytes that a connection of the principal has sent or received.
    void spend(const std::string& principal, Direction direction, std::uint64_t bytes,
               Clock::time_point now) {
        const std::uint64_t rate = quotas_.of(principal).second_bytes;
        if (rate >= unlimited) return;
        if (next_.size() >= principals_max) forget_idle(now);
        Clock::time_point& next = next_[principal][static_cast<std::size_t>(direction)];
        const std::chrono::duration<double> time(static_cast<double>(bytes) /
                                                 static_cast<double>(rate));
        next = std::max(next, now - burst) + std::chrono::duration_cast<Clock::duration>(time);
    }

    /// Returns when the principal may send or receive again; a time that has passed: now.
    [[nodiscard]] Clock::time_point next(const std::string& principal, Direction direction) const {
        if (next_.empty()) return {};
        const auto found = next_.find(principal);
        return found == next_.end() ? Clock::time_point()
                                    : found->second[static_cast<std::size_t>(direction)];
    }

private:
    /// Rates from here on are not counted.
    static constexpr std::uint64_t unlimited = 1ULL << 40;
    /// Time whose bytes a principal may send at once after a pause.
    static constexpr std::chrono::milliseconds burst{100};
    static constexpr std::size_t principals_max = 1024;

    void forget_idle(Clock::time_point now) {
        std::erase_if(
            next_, [&](const auto& entry) { return std::ranges::max(entry.second) < now - burst; });
    }

    const Quotas& quotas_;
    std::map<std::string, std::array<Clock::time_point, 2>> next_;
};

}  // namespace raynest::server
