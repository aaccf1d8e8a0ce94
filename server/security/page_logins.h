// Logins of the page: the codes of `raynest open`, and what the cookie of a browser stands for.
//
//   token or code ──POST /v1/login──► begin() ──secret──► cookie ──► find() ──► Principal
//
// Only hashes of codes and cookies are kept, and only in memory: both end with the daemon.
#pragma once

#include "protocol/limits.h"
#include "server/principal.h"
#include "server/security/tokens.h"

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

namespace raynest::server {

/// Io thread only.
class PageLogins {
public:
    using Time = WallClock::time_point;

    explicit PageLogins(const protocol::Limits& limits = {})
        : code_time_(limits.page_code_ms_max),
          login_time_(limits.page_login_ms_max) {}

    /// Returns a code that begins one login as this principal, within page_code_ms_max.
    [[nodiscard]] std::string make_code(const Principal& principal, Time now);
    /// Returns the principal of a code and forgets the code. Nothing if it was used, has expired or
    /// never was one.
    [[nodiscard]] std::optional<Principal> take_code(std::string_view code, Time now);

    /// Begins a login. Returns the secret for its cookie.
    [[nodiscard]] std::string begin(Principal principal, Time now);
    /// Returns the principal of a cookie; null if its login has ended.
    [[nodiscard]] const Principal* find(std::string_view secret, Time now) const;
    /// True until the login of this number (Principal::page_login) has ended.
    [[nodiscard]] bool goes_on(std::uint64_t number) const;
    /// Ends a login; false if there is none.
    bool end(std::string_view secret);
    /// Ends logins whose time is over. True if there were any.
    bool expire(Time now);

private:
    struct Entry {
        Principal principal;
        Time expires;
    };
    using Entries = std::map<TokenHash, Entry>;
    /// Adds an entry, and returns its secret. The one that expires first gives way.
    static std::string add(Entries& entries, std::size_t most, Principal principal, Time expires);

    const std::chrono::milliseconds code_time_;
    const std::chrono::milliseconds login_time_;
    Entries codes_;
    Entries logins_;
    std::uint64_t last_number_ = 0;
};

}  // namespace raynest::server
