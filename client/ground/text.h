// Texts of numbers for people, texts of others as a terminal may show them, and variables of the environment.
#pragma once

#include "protocol/text.h"

#include <cstdint>
#include <string>
#include <string_view>

namespace raynest::client {

/// Returns the text as a terminal may show it: one line, '?' in the place of control characters.
[[nodiscard]] std::string shown_text(std::string_view text);
/// Returns "1,234,567".
[[nodiscard]] std::string grouped(std::uint64_t number);
using protocol::bytes_text;
/// Returns "0.412 s".
[[nodiscard]] std::string seconds_text(double seconds);
/// Returns "12s", "5m", "3h" or "2d", in the largest unit that gives at least 1.
[[nodiscard]] std::string age_text(double seconds);
/// Returns the shortest text of a float that reads back the same; "null" if it is not finite.
[[nodiscard]] std::string float_text(float value);
/// The same of a double.
[[nodiscard]] std::string double_text(double value);
/// The same for a coordinate in the world, given relative to the scene's origin.
[[nodiscard]] std::string world_text(float relative, double origin);
/// Returns the value of a variable of the environment; empty if there is none.
[[nodiscard]] std::string environment_variable(const char* name);

}  // namespace raynest::client
