#include "client/ground/progress.h"

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace raynest::client {

using namespace std::chrono_literals;

namespace {

constexpr auto first_after = 500ms;
constexpr auto drawn_every = 100ms;

/// Blocks signals in the drawing thread, so that they wake the thread that waits for the daemon.
class SignalsBlocked {
public:
    SignalsBlocked() {
        sigset_t all;
        sigfillset(&all);
        pthread_sigmask(SIG_SETMASK, &all, &before_);
    }
    ~SignalsBlocked() { pthread_sigmask(SIG_SETMASK, &before_, nullptr); }
    SignalsBlocked(const SignalsBlocked&) = delete;

private:
    sigset_t before_;
};

}  // namespace

Progress::Style Progress::style_for_stderr(bool quiet) {
    return !quiet && ::isatty(STDERR_FILENO) != 0 ? Style::bar : Style::none;
}

Progress::Progress(Style style) : style_(style) {
    if (style == Style::none) return;
    const SignalsBlocked blocked;
    thread_ = std::thread([this] { draw_until_stopped(); });
}

Progress::~Progress() {
    if (!thread_.joinable()) return;
    {
        const std::lock_guard lock(mutex_);
        stopped_ = true;
    }
    wake_.notify_one();
    thread_.join();
    erase();
}

void Progress::clear() {
    const std::lock_guard lock(mutex_);
    shown_ = false;
    erase();
}

void Progress::update(std::uint64_t done, std::uint64_t total, std::string_view stage) {
    if (style_ == Style::none) return;
    const std::lock_guard lock(mutex_);
    done_ = done;
    total_ = total;
    stage_ = stage.empty() ? "working" : stage;
    shown_ = true;
}

void Progress::draw_until_stopped() {
    std::unique_lock lock(mutex_);
    wake_.wait_for(lock, first_after, [&] { return stopped_; });
    while (!stopped_) {
        if (shown_) draw();
        wake_.wait_for(lock, drawn_every, [&] { return stopped_; });
    }
}

void Progress::draw() {
    std::string line = stage_;
    if (total_ != 0) {
        const double share =
            std::min(1.0, static_cast<double>(done_) / static_cast<double>(total_));
        constexpr std::size_t width = 30;
        const auto full = static_cast<std::size_t>(share * static_cast<double>(width));
        line += " [" + std::string(full, '#') + std::string(width - full, '.') + "] " +
                std::to_string(static_cast<int>(share * 100)) + "%";
    }
    const auto seconds =
        std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - start_).count();
    std::fprintf(stderr, "\r%s %lld s\x1b[K", line.c_str(), static_cast<long long>(seconds));
    visible_ = true;
}

void Progress::erase() {
    if (visible_) std::fputs("\r\x1b[K", stderr);
    visible_ = false;
}

}  // namespace raynest::client
