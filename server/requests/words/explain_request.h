// Shared by the requests that explain a ray or a path.
#pragma once

#include "server/execution/plan.h"
#include "server/ground/budget.h"
#include "server/jobs/services.h"
#include "server/security/caller.h"

#include <array>
#include <cstdint>
#include <string_view>

namespace raynest::server {

/// Reserves memory for a document of `entries` entries.
Reply<Budget::Lease> reserve_explanation(const Services& services, const Caller& caller,
                                         std::uint64_t entries, std::string_view fewer);
/// Returns the submission of such a job; the caller adds the job itself.
[[nodiscard]] JobSubmission accept_explanation(const Caller& caller, const Plan& plan,
                                               std::uint64_t bytes, std::string_view fewer);

/// Column and row, from the upper left corner.
using Pixel = std::array<std::uint32_t, 2>;
/// Checks that a pixel lies in a picture.
Reply<void> check_pixel(const Pixel& pixel, std::uint32_t width, std::uint32_t height);

}  // namespace raynest::server
