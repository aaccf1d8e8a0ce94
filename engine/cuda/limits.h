// What a GPU takes: how deep a scene, how long a ray. Apart from the traversal, so that who knows
// nothing of kernels can ask.
#pragma once

#include <cstdint>

namespace raynest::cuda {

/// BVHs on a path. Deeper scenes are the CPU's.
inline constexpr std::uint32_t levels_max = 8;

/// Steps of a ray's search: nodes and instances that it enters, triangles and records that it
/// tests, so each waits for memory a few times at most. A hundred times what the longest take that
/// are meant to hit something (1,500 in the built-in forest). A kernel cannot be stopped but with
/// its process; a ray that meets all that a scene holds ends here, and its call is the CPU's.
inline constexpr std::uint32_t ray_steps_max = 1U << 18;

}  // namespace raynest::cuda
