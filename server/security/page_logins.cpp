#include "server/security/page_logins.h"

#include <algorithm>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::size_t codes_max = 256;
constexpr std::size_t logins_max = 1024;

}  // namespace

std::string PageLogins::add(Entries& entries, std::size_t most, Principal principal, Time expires) {
    if (entries.size() >= most)
        entries.erase(std::ranges::min_element(
            entries, {}, [](const auto& entry) { return entry.second.expires; }));
    std::string secret = new_secret();
    entries.insert_or_assign(hash_token(secret), Entry{std::move(principal), expires});
    return secret;
}

std::string PageLogins::make_code(const Principal& principal, Time now) {
    return add(codes_, codes_max, principal, now + code_time_);
}

std::optional<Principal> PageLogins::take_code(std::string_view code, Time now) {
    const auto found = codes_.find(hash_token(code));
    if (found == codes_.end()) return std::nullopt;
    const Entry entry = std::move(found->second);
    codes_.erase(found);
    return now < entry.expires ? std::optional(entry.principal) : std::nullopt;
}

std::string PageLogins::begin(Principal principal, Time now) {
    principal.page_login = ++last_number_;
    return add(logins_, logins_max, std::move(principal), now + login_time_);
}

const Principal* PageLogins::find(std::string_view secret, Time now) const {
    if (secret.empty()) return nullptr;
    const auto found = logins_.find(hash_token(secret));
    return found == logins_.end() || now >= found->second.expires ? nullptr
                                                                  : &found->second.principal;
}

bool PageLogins::goes_on(std::uint64_t number) const {
    return std::ranges::any_of(
        logins_, [&](const auto& entry) { return entry.second.principal.page_login == number; });
}

bool PageLogins::end(std::string_view secret) {
    return logins_.erase(hash_token(secret)) != 0;
}

bool PageLogins::expire(Time now) {
    const auto is_over = [&](const auto& entry) { return now >= entry.second.expires; };
    std::erase_if(codes_, is_over);
    return std::erase_if(logins_, is_over) != 0;
}

}  // namespace raynest::server
