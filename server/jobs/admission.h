// Which jobs are in flight, and whether one more may be: a bound for the daemon, and quotas for
// each principal, so that none can fill the daemon for all others.
//
// A job counts from its start until its last task really ended: cancelling is never cheaper than
// working.
#pragma once

#include "protocol/limits.h"
#include "server/jobs/job.h"
#include "server/jobs/peers.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {

/// What the daemon knows of a job besides its work.
struct JobRecord {
    std::uint64_t number = 0;  ///< never used again
    std::string principal;
    std::string kind;
    std::string detail;
    std::string worker;
    std::string scene;
    std::uint64_t rays = 0;  ///< that it was asked to trace
    bool detached = false;
    Clock::time_point started;
    Clock::time_point deadline = Clock::time_point::max();
    const Job* job = nullptr;  ///< null once it has ended
    std::function<void()> cancel;
};

/// Io thread only; must outlive its slots.
class Admission {
public:
    /// A place among the jobs in flight. Move-only.
    class Slot {
    public:
        Slot() = default;
        Slot(Slot&& other) noexcept
            : admission_(std::exchange(other.admission_, nullptr)),
              number_(other.number_) {}
        Slot& operator=(Slot&& other) noexcept {
            std::swap(admission_, other.admission_);
            std::swap(number_, other.number_);
            return *this;
        }
        Slot(const Slot&) = delete;
        ~Slot() {
            if (admission_ != nullptr) admission_->leave(number_);
        }
        [[nodiscard]] std::uint64_t number() const { return number_; }

    private:
        friend class Admission;
        Slot(Admission* admission, std::uint64_t number) : admission_(admission), number_(number) {}
        Admission* admission_ = nullptr;
        std::uint64_t number_ = 0;
    };

    /// At most total_jobs_max jobs at once; the quotas are principal_jobs_max and
    /// principal_rays_max.
    explicit Admission(const protocol::Limits& limits) : limits_(limits) {}
    Admission(const Admission&) = delete;

    /// A place for a job, which gets its number; QUOTA when the principal has too much in flight,
    /// BUSY with the time to come back when the daemon has. Without a place the record stays as it
    /// is.
    Reply<Slot> enter(JobRecord&& record);

    /// Whose job would have to end, for the principal to have a place for one more.
    [[nodiscard]] std::optional<Peers::Whose> whose_place_lacks(const std::string& principal) const;

    /// A job took this long: a moving mean says when a place is likely free.
    void record(std::chrono::duration<double> took) { mean_ += 0.1 * (took.count() - mean_); }

    /// 10 ms .. 10 s: the mean time of a job, shared by those that run.
    [[nodiscard]] std::uint32_t retry_after_ms() const;
    [[nodiscard]] std::size_t active() const { return jobs_.size(); }
    /// By number.
    [[nodiscard]] const std::map<std::uint64_t, JobRecord>& jobs() const { return jobs_; }
    /// null when it is not in flight.
    [[nodiscard]] const JobRecord* find(std::uint64_t number) const;

private:
    struct Use {
        std::uint64_t jobs = 0;
        std::uint64_t rays = 0;
    };
    void leave(std::uint64_t number);

    const protocol::Limits limits_;
    std::map<std::uint64_t, JobRecord> jobs_;
    std::map<std::string, Use> uses_;  ///< of principals that have jobs in flight
    std::uint64_t last_number_ = 0;
    double mean_ = 0.1;
};

}  // namespace raynest::server
