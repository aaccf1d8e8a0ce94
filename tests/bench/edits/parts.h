// Figures of moves whose cost might follow what stands beside the part that moves.
#pragma once

#include <nlohmann/json.hpp>

#include <cstdint>

namespace raynest::bench {

/// Moves parts at the rim of a flat field of `count`, parts of groups of up to so many, and parts of
/// scenes of 10,000 and ten times `count` by the texts of their paths.
nlohmann::json part_figures(std::uint32_t count, int rounds);

}  // namespace raynest::bench
