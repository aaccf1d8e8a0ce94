// Logins of the page: the codes of `raynest open`, and what the cookie of a browser stands for.
//
//   token or code ──POST /v1/login──► begin() ──secret──► cookie ──► find() ──► Principal
//
// Only hashes of codes and cookies are kept, and only in memory: both end with the daemon.
#pragma once

#include "protocol/limits.h"
#include "server/ground/errors.h"
#include "server/security/principal.h"
#include "server/security/tokens.h"

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

    explicit PageLogins(const protocol::Limits& limits = {}) : limits_(limits) {}

    /// Changes the limits, also for codes and logins that there are.
    void set_limits(const protocol::Limits& limits) { limits_ = limits; }

    /// Returns a code that begins one login as this principal, within page_code_ms_max. Fails with
    /// BUSY if all principals together have too many.
    [[nodiscard]] Reply<std::string> make_code(const Principal& principal, Time now);
    /// Returns the principal of a code; null if it was used, has expired or never was one.
    [[nodiscard]] const Principal* find_code(std::string_view code, Time now) const;
    /// Returns the principal of a code, likewise, and forgets the code.
    [[nodiscard]] std::optional<Principal> take_code(std::string_view code, Time now);

    /// Begins a login. One that a login of the page has made ends when that ends. Returns the
    /// secret for its cookie. Fails with BUSY if all principals together have too many.
    [[nodiscard]] Reply<std::string> begin(Principal principal, Time now);
    /// Returns the principal of a cookie; null if its login has ended.
    [[nodiscard]] const Principal* find(std::string_view secret, Time now) const;
    /// True until the login of this number (Principal::page_login) has ended.
    [[nodiscard]] bool goes_on(std::uint64_t number) const { return logins_.contains(number); }
    /// Ends a login and those that it has made; false if there is none.
    bool end(std::string_view secret);
    /// Ends logins whose time is over. True if any has ended since the last call.
    bool expire(Time now);

private:
    struct Entry {
        TokenHash hash{};  ///< hash of the secret
        Principal principal;
        Time begun;                ///< for a login that another has made: when that one began
        std::uint64_t parent = 0;  ///< number of the login that has made it; 0: none
    };
    /// By number, so the oldest first. Looked through from end to end: there are entries_max at
    /// most.
    using Entries = std::map<std::uint64_t, Entry>;

    /// Adds an entry, and returns its secret. If its principal has `most`, the oldest of these
    /// ends.
    Reply<std::string> add(Entries& entries, std::uint64_t most, Entry entry);
    void erase(Entries& entries, Entries::const_iterator entry);
    [[nodiscard]] static Entries::const_iterator find_secret(const Entries& entries,
                                                             std::string_view secret,
                                                             std::uint64_t time_ms, Time now);

    protocol::Limits limits_;
    Entries codes_;
    Entries logins_;
    std::uint64_t last_number_ = 0;
    bool ended_ = false;
};

}  // namespace raynest::server
