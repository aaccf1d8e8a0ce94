// Which worker a job goes to: a fixed rule (PROTOCOL.md, "Workers").
#pragma once

#include "server/device/worker.h"
#include "server/errors.h"
#include "server/jobs/job.h"

#include <cstdint>
#include <string>

namespace raynest::server {

struct Plan;
struct Services;

struct WorkerChoice {
    std::string asked;               ///< auto | cpu | cuda, as the request says
    device::Worker* cuda = nullptr;  ///< null: the CPU
    std::string reason;              ///< of auto: why this one; empty where there is no choice

    [[nodiscard]] bool demanded() const { return asked == "cuda"; }
    [[nodiscard]] const char* name() const { return cuda != nullptr ? "cuda" : "cpu"; }
};

/// Below so many rays the way to a GPU and back is not worth while for `auto`.
inline constexpr std::uint64_t cuda_rays_min = 65536;

/// Sets plan.worker, which says what was asked, for a job of so many rays; the rest of the plan is
/// made. Fails on an unknown word, and where the request demands what cannot be.
Reply<void> choose_worker(const Services& services, std::uint64_t rays, Plan& plan);

/// As an error of a job that demanded it.
[[nodiscard]] protocol::Error cuda_refused(const device::Refusal& refusal);

}  // namespace raynest::server
