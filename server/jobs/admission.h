// How many jobs the daemon runs at once, and when a refused client should come back.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

namespace raynest::server {

/// enter() and record() belong to the io thread; slots may end anywhere.
class Admission {
public:
    /// A place among the running jobs; kept until the last task of the job really ended, so that
    /// cancelling is never cheaper than working. Move-only.
    class Slot {
    public:
        Slot() = default;
        Slot(Slot&& other) noexcept : active_(std::exchange(other.active_, nullptr)) {}
        Slot& operator=(Slot&& other) noexcept {
            std::swap(active_, other.active_);
            return *this;
        }
        Slot(const Slot&) = delete;
        ~Slot() {
            if (active_ != nullptr) --*active_;
        }

    private:
        friend class Admission;
        explicit Slot(std::atomic<std::size_t>* active) : active_(active) {}
        std::atomic<std::size_t>* active_ = nullptr;
    };

    explicit Admission(std::size_t jobs_max) : jobs_max_(jobs_max) {}
    Admission(const Admission&) = delete;

    /// Nothing when the daemon is full.
    [[nodiscard]] std::optional<Slot> enter() {
        if (active_ >= jobs_max_) return std::nullopt;
        ++active_;
        return Slot(&active_);
    }

    /// A job took this long: a moving mean says when a place is likely free.
    void record(std::chrono::duration<double> took) { mean_ += 0.1 * (took.count() - mean_); }

    /// 10 ms .. 10 s: the mean time of a job, shared by those that run.
    [[nodiscard]] std::uint32_t retry_after_ms() const {
        const double ms = 1e3 * mean_ / static_cast<double>(jobs_max_);
        return static_cast<std::uint32_t>(std::clamp(ms, 10.0, 10'000.0));
    }
    [[nodiscard]] std::size_t active() const { return active_; }

private:
    const std::size_t jobs_max_;
    std::atomic<std::size_t> active_{0};
    double mean_ = 0.1;
};

}  // namespace raynest::server
