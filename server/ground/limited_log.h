// The log of events that peers cause: a peer gets a few lines per second and event, and the rest is
// counted, so that nobody fills a disk or hides what others do. Peers that are known by their address
// alone share a total, because one machine may have many addresses. Lines of the daemon's own doing go
// to log() itself.
#pragma once

#include "server/ground/log.h"

#include <chrono>
#include <cstdint>
#include <initializer_list>
#include <map>
#include <string>
#include <string_view>

namespace raynest::server {

/// Lets a few lines per second and source through, and counts the rest. Not thread-safe.
class LineLimit {
public:
    using Time = std::chrono::steady_clock::time_point;
    static constexpr unsigned lines_max = 5;          ///< for a source, per second
    static constexpr std::size_t sources_max = 40;    ///< of each group, with lines in one second
    static constexpr unsigned remote_lines_max = 15;  ///< of all remote addresses, per second

    /// Lines that were left out, and the source of most of them.
    struct LeftOut {
        std::uint64_t lines = 0;
        std::string source = {};
        std::uint64_t lines_of_source = 0;
    };

    /// True if a line may be written; false counts it as left out.
    bool admit(const std::string& source, Time now);
    /// Returns the lines left out since the last call; none while their second goes on.
    LeftOut take_left_out(Time now);

private:
    struct Lines {
        std::uint64_t written = 0;
        std::uint64_t left_out = 0;
    };
    /// The lines of this second.
    struct Group {
        std::map<std::string, Lines, std::less<>> by_source = {};
        std::uint64_t written = 0;
        std::uint64_t of_others = 0;  ///< left out, of sources beyond sources_max
    };
    static constexpr std::chrono::seconds period{1};
    /// Begins another second if this one is over.
    void begin(Time now);

    Time begin_ = Time() - period;
    Group known_;
    Group remote_;      ///< sources that are addresses of other machines
    LeftOut left_out_;  ///< in seconds that are over
};

/// Logs an event within a LineLimit of its own. `source` is the principal or address that causes
/// it; empty where several peers do. Thread-safe.
void log_limited(LogLevel level, std::string_view event, std::string_view source,
                 std::initializer_list<LogField> fields);

/// Logs how many lines of each event were left out, if any. Call it now and then. Thread-safe.
void log_left_out();

}  // namespace raynest::server
