// Where an instance stands in a scene: the way down to it.
#pragma once

#include <compare>
#include <cstdint>
#include <utility>
#include <vector>

namespace raynest {

/// An instance, by its place among those of its object, and the places of the instances above it.
struct InstancePlace {
    std::uint32_t outermost = 0;       ///< among the instances of the root
    std::vector<std::uint32_t> below;  ///< the others, from above; empty for an outermost instance

    InstancePlace(std::uint32_t in_root = 0, std::vector<std::uint32_t> below_it = {})  // NOLINT
        : outermost(in_root),
          below(std::move(below_it)) {}
    auto operator<=>(const InstancePlace&) const = default;
};

}  // namespace raynest
