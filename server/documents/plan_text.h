// A plan's parameters and mask as text.
#pragma once

#include "server/execution/plan.h"

#include <array>
#include <charconv>
#include <cstdint>
#include <span>
#include <string>

namespace raynest::server {

/// Returns the shortest digits that give the number again.
template <class Number>
std::string number_text(Number value) {
    std::array<char, 64> digits{};
    return {digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr};
}

/// Returns the parameters of a plan's intersector as name=value, joined by blanks: all of them, or
/// those that differ from their initial value.
[[nodiscard]] std::string settings_text(const Plan& plan, bool all = true);
/// Returns "[3:1f2e...]", the number of values and their hash: tables with other values have
/// another text.
[[nodiscard]] std::string table_text(std::span<const float> values);
/// Returns a mask as messages show it: 00000001.
[[nodiscard]] std::string mask_text(std::uint32_t mask);

}  // namespace raynest::server
