// The quotas of each principal: the limits principal_*_max, or less or more by its token's row or an
// administrator.
#pragma once

#include "server/principal.h"

#include <map>
#include <string>

namespace raynest::server {

/// Io thread only.
class Quotas {
public:
    explicit Quotas(const protocol::Limits& limits) { set_limits(limits); }

    /// Changes the quotas of principals without others.
    void set_limits(const protocol::Limits& limits) {
        usual_ = {limits.principal_connections_max, limits.principal_jobs_max,
                  limits.principal_rays_max, limits.principal_scene_bytes_max,
                  limits.principal_second_bytes_max};
    }

    /// Replaces the quotas of a principal; 0 means the usual one.
    void set(const std::string& principal, const Quota& quota) {
        if (quota == Quota{})
            special_.erase(principal);
        else
            special_[principal] = quota;
    }
    /// Returns quotas without zeros.
    [[nodiscard]] Quota of(const std::string& principal) const {
        const auto found = special_.find(principal);
        if (found == special_.end()) return usual_;
        Quota quota = found->second;
        const auto fill = [&](std::uint64_t Quota::*value) {
            if (quota.*value == 0) quota.*value = usual_.*value;
        };
        fill(&Quota::connections);
        fill(&Quota::jobs);
        fill(&Quota::rays);
        fill(&Quota::scene_bytes);
        fill(&Quota::second_bytes);
        return quota;
    }

private:
    Quota usual_;
    std::map<std::string, Quota> special_;
};

}  // namespace raynest::server
