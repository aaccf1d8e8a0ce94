// The jobs in flight, and the limits on their number: one for the daemon, of which principals have
// fair shares (fair_share.h), and quotas for each principal.
//
// A job counts from its start until its last task has ended, even after a cancel. So a client gains
// nothing by cancelling jobs and starting new ones.
#pragma once

#include "protocol/limits.h"
#include "server/scheduling/bandwidth.h"
#include "server/scheduling/job.h"
#include "server/scheduling/peers.h"
#include "server/security/quotas.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {

/// A job's description, for limits, listings and the log.
struct JobRecord {
    std::uint64_t number = 0;  ///< unique; never reused
    std::string principal;
    std::string kind;
    std::string detail;
    std::string worker;
    std::string scene;
    std::uint64_t rays = 0;  ///< rays that the request asks for
    bool detached = false;
    Clock::time_point started;
    Clock::time_point deadline = Clock::time_point::max();
    const Job* job = nullptr;  ///< null before it begins and once it has ended
    std::function<void()> cancel;
};

/// Counts the jobs in flight. Io thread only; must outlive its slots.
class Admission {
public:
    /// A place among the jobs in flight; the destructor frees it. Move-only.
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

    /// Limits: total_jobs_max of the daemon; principal_jobs_max, principal_rays_max of a principal.
    explicit Admission(const protocol::Limits& limits)
        : limits_(limits),
          quotas_(limits),
          bandwidth_(quotas_) {}
    Admission(const Admission&) = delete;

    /// Gives a job a place and a number. Fails with QUOTA if the principal has too much in flight,
    /// and with BUSY and a retry time if the daemon has, or if the principal has its share of that.
    /// On failure `record` is unchanged.
    Reply<Slot> enter(JobRecord&& record);

    /// Returns whose job must end before the principal can start one more; nothing if none must.
    [[nodiscard]] std::optional<Peers::Whose> blocking_limit(const std::string& principal) const;

    /// Changes the limits; jobs in flight stay.
    void set_limits(const protocol::Limits& limits) {
        limits_ = limits;
        quotas_.set_limits(limits);
    }
    /// Quotas that differ from the default limits, by principal.
    [[nodiscard]] Quotas& quotas() { return quotas_; }
    [[nodiscard]] Bandwidth& bandwidth() { return bandwidth_; }

    /// Adds the duration of a job to the moving mean behind retry_after_ms().
    void record(std::chrono::duration<double> took) { mean_ += 0.1 * (took.count() - mean_); }

    /// Number of jobs of this principal in flight.
    [[nodiscard]] std::size_t active_of(const std::string& principal) const {
        const auto known = uses_.find(principal);
        return known == uses_.end() ? 0 : known->second.jobs;
    }

    /// Returns the expected time until a job ends, 10 ms to 10 s: the mean duration of a job over
    /// total_jobs_max.
    [[nodiscard]] std::uint32_t retry_after_ms() const;
    [[nodiscard]] std::size_t active() const { return jobs_.size(); }
    /// The jobs in flight, by number.
    [[nodiscard]] const std::map<std::uint64_t, JobRecord>& jobs() const { return jobs_; }
    /// Sets JobRecord::job to null, because the job is about to be destroyed.
    void forget_job(std::uint64_t number) noexcept;
    /// Returns null if the job is not in flight.
    [[nodiscard]] const JobRecord* find(std::uint64_t number) const;

private:
    struct Use {
        std::uint64_t jobs = 0;
        std::uint64_t rays = 0;
    };
    void leave(std::uint64_t number);
    /// Places that are free, of total_jobs_max.
    [[nodiscard]] std::uint64_t free_places() const {
        return limits_.total_jobs_max - std::min<std::uint64_t>(active(), limits_.total_jobs_max);
    }

    protocol::Limits limits_;
    Quotas quotas_;
    Bandwidth bandwidth_;
    std::map<std::uint64_t, JobRecord> jobs_;
    std::map<std::string, Use> uses_;  ///< by principal, for those with jobs in flight
    std::uint64_t last_number_ = 0;
    double mean_ = 0.1;  ///< duration of a job in seconds
};

}  // namespace raynest::server
