#include "client/progress.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <string>

namespace raynest::client {

using namespace std::chrono_literals;

Progress::Style Progress::style_for_stderr(bool quiet) {
    if (quiet) return Style::none;
    return ::isatty(STDERR_FILENO) != 0 ? Style::bar : Style::lines;
}

Progress::~Progress() {
    clear();
}

void Progress::clear() {
    if (visible_) std::fputs("\r\x1b[K", stderr);
    visible_ = false;
}

void Progress::update(std::uint64_t done, std::uint64_t total, std::string_view stage) {
    const Clock::time_point now = Clock::now();
    if (style_ == Style::none ||
        now - shown_ < (style_ == Style::bar ? Clock::duration(100ms) : 5s))
        return;
    shown_ = now;

    std::string line(stage.empty() ? "working" : stage);
    if (total != 0) {
        const double share = std::min(1.0, static_cast<double>(done) / static_cast<double>(total));
        if (style_ == Style::bar) {
            constexpr std::size_t width = 30;
            const auto full = static_cast<std::size_t>(share * static_cast<double>(width));
            line += " [" + std::string(full, '#') + std::string(width - full, '.') + "]";
        }
        line += " " + std::to_string(static_cast<int>(share * 100)) + "%";
    }
    const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(now - start_).count();
    line += " " + std::to_string(seconds) + " s";
    if (style_ == Style::bar) {
        std::fprintf(stderr, "\r%s\x1b[K", line.c_str());
        visible_ = true;
    } else {
        std::fprintf(stderr, "raynest: %s\n", line.c_str());
    }
}

}  // namespace raynest::client
