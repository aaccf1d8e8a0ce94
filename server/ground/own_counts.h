// What each principal did, for those that are told nothing of others.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

namespace raynest::server {

/// Counts of each principal, by the position of a counter in metric_table. Thread-safe.
class OwnCounts {
public:
    static constexpr std::size_t counters_max = 80;

    /// Adds to a counter of a principal; to none if `principal` is empty, as before Hello.
    void add(const std::string& principal, std::size_t counter, std::uint64_t count);
    /// Returns 0 for a principal that has done nothing, or nothing for long.
    [[nodiscard]] std::uint64_t of(const std::string& principal, std::size_t counter) const;

    /// Returns the principals that did something last, latest first, at most `most` of them.
    [[nodiscard]] std::vector<std::string> latest(std::size_t most) const;

private:
    struct Row {
        std::array<std::uint64_t, counters_max> counts{};
        std::uint64_t last = 0;  ///< when it was last added to, by `clock_`
    };
    mutable std::mutex mutex_;
    std::unordered_map<std::string, Row> rows_;
    std::uint64_t clock_ = 0;
};

}  // namespace raynest::server
