#include "server/security/quotas.h"

#include "server/security/tokens.h"

#include <algorithm>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// The words for a quota: its key, the option of its usual value, and its least value.
struct Words {
    Quotas::Field field;
    std::string_view key;
    std::uint64_t least;

    [[nodiscard]] std::string option() const {
        std::string name = "--principal-" + std::string(key) + "-max";
        std::ranges::replace(name, '_', '-');
        return name;
    }
};
constexpr std::array table = {
#define RAYNEST_QUOTA(key, least) Words{&Quota::key, #key, least},
#include "protocol/lists/quotas.def"
};

const Words& words_of(Quotas::Field field) {
    return *std::ranges::find(table, field, &Words::field);
}

tl::unexpected<Error> not_a_quota(std::string_view text, const std::string& why) {
    std::string message = "'";
    message.append(text).append("' is not a quota: ").append(why);
    return fail(ErrorCode::param_invalid, std::move(message));
}

}  // namespace

std::string Quotas::limit_text(const std::string& principal, Field field) const {
    const Words& words = words_of(field);
    const std::string value = std::to_string(of(principal).*field);
    if (is_own(principal, field)) return "its quota is " + std::string(words.key) + "=" + value;
    return "the limit is " + words.option() + " " + value;
}

std::string Quotas::remedy(const std::string& principal, Field field) const {
    const Words& words = words_of(field);
    if (!is_own(principal, field)) return "start raynestd with a larger " + words.option();
    return "ask an administrator for more: raynest admin quota " + principal + " " +
           std::string(words.key) + "=N";
}

std::string quota_keys() {
    std::string keys;
    for (const Words& words : table) {
        if (!keys.empty()) keys += ", ";
        keys.append(words.key).append("=N");
    }
    return keys;
}

Result<Quota> read_quota(std::string_view text) {
    if (text.empty()) return not_a_quota(text, "write one such as jobs=8,rays=1000000");
    const auto quota = parse_quota(text);
    if (!quota || text.back() == ',')
        return not_a_quota(text,
                           "write one or more of " + quota_keys() + ", with commas between them");
    std::vector<std::string_view> seen;
    for (std::string_view left = text; !left.empty();) {
        const std::string_view part = left.substr(0, left.find(','));
        left.remove_prefix(std::min(left.size(), part.size() + 1));
        const std::string_view key = part.substr(0, part.find('='));
        if (std::ranges::count(seen, key) != 0)
            return not_a_quota(text, std::string(key) + " is given twice; keep one of them");
        seen.push_back(key);
    }
    for (const Words& words : table)
        if (const std::uint64_t value = *quota.*words.field; value != 0 && value < words.least)
            return not_a_quota(
                text, "the least " + std::string(words.key) + " is " + std::to_string(words.least));
    return *quota;
}

}  // namespace raynest::server
