#include "server/security/page_logins.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

/// Codes, and logins, of all principals together: a bound of memory, about 2 MiB each.
constexpr std::size_t entries_max = 4096;
constexpr std::uint32_t retry_ms = 1000;

bool is_over(PageLogins::Time begun, std::uint64_t time_ms, PageLogins::Time now) {
    return now >= begun + std::chrono::milliseconds(time_ms);
}

}  // namespace

Reply<std::string> PageLogins::add(Entries& entries, std::uint64_t most, Entry entry) {
    const auto is_own = [&](const auto& known) {
        return known.second.principal.id == entry.principal.id;
    };
    const auto may_go = [&](const auto& known) {
        for (std::uint64_t ancestor = entry.parent; ancestor != 0;
             ancestor = logins_.at(ancestor).parent)
            if (ancestor == known.first) return false;
        return is_own(known);
    };
    const bool is_full = static_cast<std::uint64_t>(std::ranges::count_if(entries, is_own)) >= most;
    // A principal voids its own entries, never another's, and not those that the new one goes with.
    const auto oldest = is_full ? std::ranges::find_if(entries, may_go) : entries.end();
    if (oldest != entries.end())
        erase(entries, oldest);
    else if (is_full || entries.size() >= entries_max)
        return tl::unexpected(
            protocol::Error{Code::busy, "the daemon has no free logins of its page", retry_ms});
    std::string secret = new_secret();
    entry.hash = hash_token(secret);
    entries.emplace(++last_number_, std::move(entry));
    return secret;
}

void PageLogins::erase(Entries& entries, Entries::const_iterator entry) {
    const std::uint64_t number = entry->first;
    entries.erase(entry);
    if (&entries != &logins_) return;
    ended_ = true;
    const auto is_child = [&](const auto& known) { return known.second.parent == number; };
    for (auto child = std::ranges::find_if(logins_, is_child); child != logins_.end();
         child = std::ranges::find_if(logins_, is_child))
        erase(logins_, child);
}

PageLogins::Entries::const_iterator PageLogins::find_secret(const Entries& entries,
                                                            std::string_view secret,
                                                            std::uint64_t time_ms, Time now) {
    if (secret.empty()) return entries.end();
    const auto found = std::ranges::find(entries, hash_token(secret),
                                         [](const auto& known) { return known.second.hash; });
    return found == entries.end() || is_over(found->second.begun, time_ms, now) ? entries.end()
                                                                                : found;
}

Reply<std::string> PageLogins::make_code(const Principal& principal, Time now) {
    return add(codes_, limits_.principal_page_codes_max, {{}, principal, now});
}

const Principal* PageLogins::find_code(std::string_view code, Time now) const {
    const auto found = find_secret(codes_, code, limits_.page_code_ms_max, now);
    return found == codes_.end() ? nullptr : &found->second.principal;
}

std::optional<Principal> PageLogins::take_code(std::string_view code, Time now) {
    const auto found = find_secret(codes_, code, limits_.page_code_ms_max, now);
    if (found == codes_.end()) return std::nullopt;
    std::optional<Principal> principal = found->second.principal;
    erase(codes_, found);
    return principal;
}

Reply<std::string> PageLogins::begin(Principal principal, Time now) {
    Entry entry{{}, std::move(principal), now};
    entry.parent = entry.principal.page_login;
    if (const auto parent = logins_.find(entry.parent); parent != logins_.end())
        entry.begun = parent->second.begun;
    else if (entry.parent != 0)
        return refuse(Code::not_allowed, "the login that made this one has ended; log in again");
    entry.principal.page_login = last_number_ + 1;
    return add(logins_, limits_.principal_page_logins_max, std::move(entry));
}

const Principal* PageLogins::find(std::string_view secret, Time now) const {
    const auto found = find_secret(logins_, secret, limits_.page_login_ms_max, now);
    return found == logins_.end() ? nullptr : &found->second.principal;
}

bool PageLogins::end(std::string_view secret) {
    const auto found = find_secret(logins_, secret, limits_.page_login_ms_max, Time::min());
    if (found == logins_.end()) return false;
    erase(logins_, found);
    return true;
}

bool PageLogins::expire(Time now) {
    std::erase_if(codes_, [&](const auto& code) {
        return is_over(code.second.begun, limits_.page_code_ms_max, now);
    });
    // Those that a login has made began when it did, and end with it.
    ended_ |= std::erase_if(logins_, [&](const auto& login) {
                  return is_over(login.second.begun, limits_.page_login_ms_max, now);
              }) != 0;
    return std::exchange(ended_, false);
}

}  // namespace raynest::server
