#include "server/documents/plan_text.h"

#include "protocol/hash.h"

#include <cstdio>
#include <string_view>

namespace raynest::server {

std::string table_text(std::span<const float> values) {
    std::array<char, 48> text{};
    std::snprintf(
        text.data(), text.size(), "[%zu:%016llx]", values.size(),
        static_cast<unsigned long long>(protocol::upload_checksum(std::as_bytes(values))));
    return text.data();
}

std::string settings_text(const Plan& plan, bool all) {
    std::string text;
    std::size_t table = 0;
    for (std::size_t i = 0; i < plan.settings.params.size(); ++i) {
        if (plan.variant->params()[i].type == value_table) {
            const Tables* tables = plan.settings.tables.get();
            const auto values =
                tables == nullptr ? std::span<const float>() : std::span(tables->values()[table]);
            ++table;
            if (!all && values.empty()) continue;
            text.append(text.empty() ? "" : " ")
                .append(plan.variant->params()[i].name)
                .append("=")
                .append(table_text(values));
            continue;
        }
        if (!all && plan.settings.params[i] == plan.variant->params()[i].initial) continue;
        std::array<char, 64> digits{};
        const char* const end =
            std::to_chars(digits.data(), digits.data() + digits.size(), plan.settings.params[i])
                .ptr;
        text.append(text.empty() ? "" : " ")
            .append(plan.variant->params()[i].name)
            .append("=")
            .append(std::string_view(digits.data(), static_cast<std::size_t>(end - digits.data())));
    }
    return text;
}

std::string mask_text(std::uint32_t mask) {
    std::array<char, 16> digits{};
    std::snprintf(digits.data(), digits.size(), "%08X", static_cast<unsigned>(mask));
    return digits.data();
}

}  // namespace raynest::server
