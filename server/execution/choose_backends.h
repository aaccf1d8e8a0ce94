// The rule that chooses the backends of a job (PROTOCOL.md, "Workers").
#pragma once

#include "server/execution/plan.h"

#include <cstdint>
#include <span>

namespace raynest::server {

/// Sets plan.backends for a job of `rays` rays from plan.backends.asked. A backend is chosen only if it
/// also accepts the plans in `others`. Fails if the requested backend is unknown or unavailable.
Reply<void> choose_backends(const Backends& backends, std::uint64_t rays, Plan& plan,
                            std::span<const Plan* const> others = {});

}  // namespace raynest::server
