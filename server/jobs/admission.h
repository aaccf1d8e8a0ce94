// Which jobs are in flight, and whether one more may be: a bound for the daemon, and quotas for
// each principal, so that none can fill the daemon for all others.
//
// A job counts from its start until its last task really ended: cancelling is never cheaper than
// working.
#pragma once

#include "protocol/limits.h"
#include "server/errors.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>

namespace raynest::server {

/// Io thread only; must outlive its slots.
class Admission {
    struct Use {
        std::uint64_t jobs = 0;
        std::uint64_t rays = 0;
    };
    using Uses = std::map<std::string, Use>;

public:
    /// A place among the jobs in flight. Move-only.
    class Slot {
    public:
        Slot() = default;
        Slot(Slot&& other) noexcept
            : admission_(std::exchange(other.admission_, nullptr)),
              use_(other.use_),
              rays_(other.rays_) {}
        Slot& operator=(Slot&& other) noexcept {
            std::swap(admission_, other.admission_);
            std::swap(use_, other.use_);
            std::swap(rays_, other.rays_);
            return *this;
        }
        Slot(const Slot&) = delete;
        ~Slot() {
            if (admission_ != nullptr) admission_->leave(use_, rays_);
        }

    private:
        friend class Admission;
        Slot(Admission* admission, Uses::iterator use, std::uint64_t rays)
            : admission_(admission),
              use_(use),
              rays_(rays) {}
        Admission* admission_ = nullptr;
        Uses::iterator use_;
        std::uint64_t rays_ = 0;
    };

    /// At most `jobs_max` jobs at once; the quotas are principal_jobs_max and principal_rays_max.
    explicit Admission(std::size_t jobs_max, const protocol::Limits& limits = {})
        : jobs_max_(jobs_max),
          limits_(limits) {}
    Admission(const Admission&) = delete;

    /// A place for a job that was asked to trace `rays`; QUOTA when the principal has too much in
    /// flight, BUSY with the time to come back when the daemon has.
    Reply<Slot> enter(const std::string& principal, std::uint64_t rays);

    /// A job took this long: a moving mean says when a place is likely free.
    void record(std::chrono::duration<double> took) { mean_ += 0.1 * (took.count() - mean_); }

    /// 10 ms .. 10 s: the mean time of a job, shared by those that run.
    [[nodiscard]] std::uint32_t retry_after_ms() const;
    [[nodiscard]] std::size_t active() const { return active_; }

private:
    void leave(Uses::iterator use, std::uint64_t rays);

    const std::size_t jobs_max_;
    const protocol::Limits limits_;
    std::size_t active_ = 0;
    Uses uses_;  ///< of principals that have jobs in flight
    double mean_ = 0.1;
};

}  // namespace raynest::server
