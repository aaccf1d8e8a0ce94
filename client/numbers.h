// Numbers as a command line writes them: separated by commas, checked to the last character.
#pragma once

#include "client/failure.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// What stands between the separators, empty parts too.
[[nodiscard]] std::vector<std::string> split(std::string_view text, char separator = ',');

/// "1,2.5,inf" -> `few` or `many` float64 that fit a float32, from which an origin is subtracted;
/// `shape` is how the text should look.
Result<std::vector<double>> parse_world(const std::string& text, std::size_t few, std::size_t many,
                                        const std::string& shape);

/// "90s", "30m", "1h" or "2d" -> milliseconds, at least 1.
Result<std::uint64_t> parse_duration(const std::string& text);

/// 1 to 8 hex digits, perhaps after 0x.
Result<std::uint32_t> parse_mask(std::string_view text);
/// "GLOB=HEX"; the daemon reads it again.
Result<void> check_mask_rule(std::string_view rule);

}  // namespace raynest::client
