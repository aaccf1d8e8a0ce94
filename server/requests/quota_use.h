// How much of its quotas a principal uses, as `raynest stats`, `raynest admin quota` and /metrics
// tell it.
#pragma once

#include "server/requests/request.h"

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

namespace raynest::server {

struct QuotaUse {
    std::string_view resource;  ///< the quota's key, such as "jobs"; "scenes" has an option alone
    std::uint64_t used = 0;
    std::uint64_t quota = 0;
};

/// Returns what a principal has in flight, holds and has open. `second_bytes`, a rate, is not among
/// them. Io thread only.
[[nodiscard]] std::array<QuotaUse, 6> quota_uses(const Services& services,
                                                 const std::string& principal);

}  // namespace raynest::server
