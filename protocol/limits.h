// The limits of limits.def as a struct of numbers and as a table.
//
// `raynestd --print-config` prints them, error messages quote their names, and an operator sets
// those that are policy: quotas and times.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

namespace raynest::protocol {

inline constexpr std::uint16_t version_min = 1;
inline constexpr std::uint16_t version_max = 1;

struct Limits {
#define RAYNEST_LIMIT(name, value, ...) std::uint64_t name = value;
#include "protocol/lists/limits.def"
};

struct LimitInfo {
    std::string_view name;
    std::uint64_t Limits::*value;
    std::string_view text;
    bool policy = false;  ///< an option of raynestd; else both ends rely on it
};

/// Every member of Limits, in order.
[[nodiscard]] std::span<const LimitInfo> limit_table();

}  // namespace raynest::protocol
