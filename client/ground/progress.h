// Shows the progress of long work: a bar on stderr if that is a terminal, else nothing.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>

namespace raynest::client {

/// The bar appears half a second after the work began. A thread draws it, so that its clock goes on
/// while the daemon is silent.
class Progress {
public:
    enum class Style { none, bar };
    /// Returns the bar if stderr is a terminal and not `quiet`.
    static Style style_for_stderr(bool quiet);

    explicit Progress(Style style);
    /// Removes the bar.
    ~Progress();
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    /// Sets the progress; `total` 0 means unknown. Cheap: the bar is drawn ten times a second.
    void update(std::uint64_t done, std::uint64_t total, std::string_view stage);
    /// Removes the bar before other output; the next update() shows it again.
    void clear();

private:
    using Clock = std::chrono::steady_clock;
    void draw_until_stopped();
    void draw();
    void erase();

    const Style style_;
    const Clock::time_point start_ = Clock::now();
    std::mutex mutex_;  ///< guards the members below
    std::condition_variable wake_;
    std::uint64_t done_ = 0;
    std::uint64_t total_ = 0;
    std::string stage_ = "working";
    bool shown_ = true;  ///< false after clear()
    bool visible_ = false;
    bool stopped_ = false;
    std::thread thread_;
};

}  // namespace raynest::client
