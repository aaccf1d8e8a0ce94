// Parses numbers of the command line: separated by commas, checked to the last character.
#pragma once

#include "client/ground/failure.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

/// Returns the parts between the separators, empty ones included.
[[nodiscard]] std::vector<std::string> split(std::string_view text, char separator = ',');

/// Parses "1,2.5,inf": `few` or `many` float64, each finite in float32 or infinite. `shape` is the
/// expected form, for messages.
Result<std::vector<double>> parse_world(const std::string& text, std::size_t few, std::size_t many,
                                        const std::string& shape);

/// Parses "480,270" to column and row.
Result<std::array<std::uint32_t, 2>> parse_pixel(const std::string& text);

/// Parses "90s", "30m", "1h" or "2d" to milliseconds, at least 1.
Result<std::uint64_t> parse_duration(const std::string& text);

/// Parses 1 to 8 hex digits, with or without 0x.
Result<std::uint32_t> parse_mask(std::string_view text);
/// Checks a "GLOB=HEX"; the daemon reads it again.
Result<void> check_mask_rule(std::string_view rule);

}  // namespace raynest::client
