// How far long work has come: a bar on stderr where that is a terminal, else a line every 5 s.
#pragma once

#include <chrono>
#include <cstdint>
#include <string_view>

namespace raynest::client {

class Progress {
public:
    enum class Style { none, lines, bar };
    /// A bar for a terminal, lines otherwise, nothing when `quiet`.
    static Style style_for_stderr(bool quiet);

    explicit Progress(Style style) : style_(style), start_(Clock::now()), shown_(start_) {}
    /// Removes the bar.
    ~Progress();
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    /// `total` 0 means that the end is not known. Cheap: shows at most ten times a second.
    void update(std::uint64_t done, std::uint64_t total, std::string_view stage);
    /// Removes the bar before something else is printed.
    void clear();

private:
    using Clock = std::chrono::steady_clock;
    Style style_;
    Clock::time_point start_;
    Clock::time_point shown_;
    bool visible_ = false;
};

}  // namespace raynest::client
