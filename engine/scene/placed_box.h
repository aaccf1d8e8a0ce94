// Computes the box of an instance in its parent's tree.
//
// Transforming the eight corners of the child's box is wasteful: a disc's square, turned by 45
// degrees, has twice the area, and each level of nesting adds to that. The tight box needs the
// child's extent along the parent's axes. It is found by a search in the child's tree, and in those
// of its instances.
#pragma once

#include "engine/geometry/box.h"
#include "engine/math/vec.h"
#include "engine/scene/content.h"

#include <cstdint>

namespace raynest {

/// True if the box is empty, or each of its coordinates is within coordinate_max.
[[nodiscard]] bool in_range(const Box& box);

struct PlacedBox {
    Box box;
    /// Distance by which rounding may move a hit along an axis of the parent; included in the box.
    double padding = 0;
};

/// Returns the rounding that a level of instances adds, as a multiple of a plain tree's.
///
/// A ray that enters an instance is transformed with rounding, so its hits lie off the exact ones
/// by about eps * |origin|, in the instance's space. In the parent's space that error, and those of
/// the levels below, grow by the condition number of the transform. Rotations and
/// uniform scales have condition 1: 32 of them add up, they do not multiply.
float placement_error(const Transform& to_parent, float child_error);

/// Returns a box that contains every possible hit with object `child` placed by `to_parent`; empty
/// for an empty tree. The trees of the child and all below must be built. `error` is the growth of
/// rounding errors at this placement, as in ObjectRecord::origin_error. Coordinates beyond 1e15 may
/// become infinite.
PlacedBox placed_box(const Content& content, std::uint32_t child, const Transform& to_parent,
                     float error);

/// Returns the box of all vertices of the last object as its instances place them, rounded to
/// float32 and not padded: the size that a user would give. Records count with their boxes. If tens
/// of thousands of placements reach equally far, their padded boxes count.
Box scene_bounds(const Content& content);

}  // namespace raynest
