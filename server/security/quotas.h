// The quotas of each principal: those that an administrator has set, else those of its row in the
// token file, else the limits principal_*_max.
#pragma once

#include "engine/result.h"
#include "server/security/principal.h"

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>

namespace raynest::server {

/// Io thread only.
class Quotas {
public:
    using Field = std::uint64_t Quota::*;

    explicit Quotas(const protocol::Limits& limits) { set_limits(limits); }

    /// Changes the quotas of principals without others.
    void set_limits(const protocol::Limits& limits) {
        usual_ = {
#define RAYNEST_QUOTA(key, least) limits.principal_##key##_max,
#include "protocol/lists/quotas.def"
        };
    }

    /// Replaces the quotas of a principal by an administrator's; 0 means the granted or usual one.
    void set(const std::string& principal, const Quota& quota) {
        put(set_, principal, quota);
    }
    /// Replaces the quotas that the principal's row in the token file grants; 0 means the usual
    /// one.
    void grant(const std::string& principal, const Quota& quota) {
        put(granted_, principal, quota);
    }

    /// Returns quotas without zeros.
    [[nodiscard]] Quota of(const std::string& principal) const {
        Quota quota = usual_;
        for (const auto* special : {&granted_, &set_})
            if (const auto found = special->find(principal); found != special->end())
                for (const Field field : fields)
                    if (found->second.*field != 0) quota.*field = found->second.*field;
        return quota;
    }
    /// True if this quota of the principal is its own, not the limit of everybody.
    [[nodiscard]] bool is_own(const std::string& principal, Field field) const {
        for (const auto* special : {&granted_, &set_})
            if (const auto found = special->find(principal);
                found != special->end() && found->second.*field != 0)
                return true;
        return false;
    }

    /// Names the limit in a refusal: "the limit is --principal-jobs-max 8", or "its quota is
    /// jobs=8".
    [[nodiscard]] std::string limit_text(const std::string& principal, Field field) const;
    /// Tells how the principal gets more: "start raynestd with a larger --principal-jobs-max", or
    /// "ask an administrator for more: raynest admin quota alice jobs=N".
    [[nodiscard]] std::string remedy(const std::string& principal, Field field) const;

private:
    static constexpr std::array fields = {
#define RAYNEST_QUOTA(key, least) &Quota::key,
#include "protocol/lists/quotas.def"
    };
    using Table = std::map<std::string, Quota>;
    static void put(Table& table, const std::string& principal, const Quota& quota) {
        if (quota == Quota{})
            table.erase(principal);
        else
            table[principal] = quota;
    }

    Quota usual_;
    Table granted_;
    Table set_;
};

/// "connections=N, jobs=N, ...": all that a quota may have.
[[nodiscard]] std::string quota_keys();

/// Parses the quota that an administrator gives: at least one key, each once, and none below its
/// least value. Rows of the token file are read by parse_quota(), which asks for less.
[[nodiscard]] Result<Quota> read_quota(std::string_view text);

}  // namespace raynest::server
