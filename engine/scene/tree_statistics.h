// What the trees of a scene are like, read from the trees: such numbers need no place in the arena
// and cannot contradict it.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>

namespace raynest {

struct TreeStatistics {
    /// Expected cost of a ray that meets the scene's box, in node visits: the surface area
    /// heuristic with the builder's costs (bvh/build_cut.h), through all levels of instances.
    double sah_cost = 0;
    std::uint32_t height = 0;  ///< nodes on the longest path of the highest tree
};

/// Of a checked scene. Linear time.
TreeStatistics measure_trees(const SceneView& scene);

}  // namespace raynest
