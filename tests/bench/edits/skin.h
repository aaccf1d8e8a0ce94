// The cost of a skinned mesh at another moment, over a build of it.
#pragma once

#include <nlohmann/json.hpp>

#include <cstdint>

namespace raynest::bench {

/// A sheet of about `vertices` vertices, which four joints bend, each of them all vertices. Returns
/// CPU seconds of all threads, best of `rounds`. Throws std::runtime_error.
nlohmann::json skin_figures(std::uint32_t vertices, int rounds);

}  // namespace raynest::bench
