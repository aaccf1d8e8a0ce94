// How much of its quotas a principal uses, as `raynest stats`, `raynest admin quota` and /metrics
// tell it.
#pragma once

#include "server/requests/request.h"

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::server {

struct QuotaUse {
    std::string_view resource;  ///< the quota's key, such as "jobs"; "scenes" has an option alone
    std::uint64_t used = 0;
    std::uint64_t quota = 0;
};

using QuotaUses = std::array<QuotaUse, 6>;

/// Returns what each of these principals has in flight, holds and has open. `second_bytes`, a rate,
/// is not among them. Passes over all scenes and jobs once. Io thread only.
[[nodiscard]] std::map<std::string, QuotaUses> quota_uses(
    const Services& services, const std::vector<std::string>& principals);
/// Returns the same of one principal.
[[nodiscard]] QuotaUses quota_uses(const Services& services, const std::string& principal);

}  // namespace raynest::server
