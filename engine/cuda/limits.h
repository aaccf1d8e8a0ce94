// Limits of a GPU: the depth of a scene and the length of a ray's search. In a file of its own, for
// code that does not include kernels.
#pragma once

#include <cstdint>

namespace raynest::cuda {

/// Most BVHs on a path. Only the CPU traces deeper scenes.
inline constexpr std::uint32_t levels_max = 8;

/// Most steps of a ray's search: nodes and instances entered, triangles and records tested; each
/// waits for memory a few times at most. This is over a hundred times the longest useful search
/// (1,500 steps in the built-in forest). Only killing its process stops a kernel, so a ray that
/// exceeds this limit ends, and the CPU traces its call.
inline constexpr std::uint32_t ray_steps_max = 1U << 18;

}  // namespace raynest::cuda
