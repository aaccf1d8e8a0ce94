// Numbers of bytes as people write them. Options, configuration files and quotas take the same
// ones.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace raynest::server {

/// Parses a number of bytes with a unit of 1024 or without one: 4096, 500m, 20G, 1.5GiB. Fractions
/// of a byte are dropped. Returns nothing for another text, and for 2^63 bytes or more.
[[nodiscard]] std::optional<std::uint64_t> parse_size(std::string_view text);

}  // namespace raynest::server
