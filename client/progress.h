// How far long work has come: a bar on stderr where that is a terminal, else nothing.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>

namespace raynest::client {

/// The bar appears half a second after the work began, and its clock runs on also while nothing is
/// heard of the daemon: a thread draws it.
class Progress {
public:
    enum class Style { none, bar };
    /// A bar for a terminal, nothing otherwise or when `quiet`.
    static Style style_for_stderr(bool quiet);

    explicit Progress(Style style);
    /// Removes the bar.
    ~Progress();
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    /// `total` 0 means that the end is not known. Cheap: the bar is drawn ten times a second.
    void update(std::uint64_t done, std::uint64_t total, std::string_view stage);
    /// Removes the bar before something else is printed; the next update() brings it back.
    void clear();

private:
    using Clock = std::chrono::steady_clock;
    void draw_until_stopped();
    void draw();
    void erase();

    const Style style_;
    const Clock::time_point start_ = Clock::now();
    std::mutex mutex_;  ///< guards what follows
    std::condition_variable wake_;
    std::uint64_t done_ = 0;
    std::uint64_t total_ = 0;
    std::string stage_ = "working";
    bool shown_ = true;  ///< rather than removed by clear()
    bool visible_ = false;
    bool stopped_ = false;
    std::thread thread_;
};

}  // namespace raynest::client
