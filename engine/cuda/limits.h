// How deep a scene may be for a GPU to take it. Apart from the traversal, so that who knows nothing
// of kernels can ask.
#pragma once

#include <cstdint>

namespace raynest::cuda {

/// BVHs on a path. Deeper scenes are the CPU's.
inline constexpr std::uint32_t levels_max = 8;

}  // namespace raynest::cuda
