// How a triangle lies in its object's tree: the columns `box_share` and `tree_depth`.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>

namespace raynest {

/// Returns the area of a triangle, given by its flat index in the object, over half the area of its
/// box: 1 for one that fills a side of its box, near 0 for a thin one across the axes, 0 without
/// area.
[[nodiscard]] float box_share(const SceneView& scene, const ObjectRecord& object,
                              std::uint32_t triangle);

/// Areas of triangles and of halves of their boxes, summed up.
struct AreaSums {
    double triangles = 0;
    double boxes = 0;
    [[nodiscard]] double share() const { return boxes > 0 ? triangles / boxes : 0; }
};
[[nodiscard]] AreaSums area_sums(const SceneView& scene, const ObjectRecord& object);

/// Returns how many triangles of an object have the same corners, on average over its triangles: 1
/// where none coincide, 0 without area. Of very large objects it looks at a share of the places.
[[nodiscard]] double triangles_in_one_place(const SceneView& scene, const ObjectRecord& object);

/// Returns the number of nodes above the leaf that holds a triangle, or no_id where none is found.
/// Descends into boxes that contain the point (1-u-v) v0 + u v1 + v v2, so that no table is needed:
/// it opens about as many nodes as a ray.
[[nodiscard]] std::uint32_t tree_depth(const SceneView& scene, const ObjectRecord& object,
                                       std::uint32_t triangle, float u, float v);

}  // namespace raynest
