// The box that an instance gets in its parent's tree.
//
// The eight corners of the child's box are the wrong thing to turn: a disc's square, turned by 45
// degrees, has twice the area, and every level of nesting adds its own. What counts is how far the
// child itself reaches along the parent's axes, which its tree answers, through the instances in
// it.
#pragma once

#include "engine/geometry/box.h"
#include "engine/math/vec.h"
#include "engine/scene/content.h"

#include <cstdint>

namespace raynest {

struct PlacedBox {
    Box box;
    /// How far rounding may move a hit along an axis of the parent: part of the box.
    double padding = 0;
};

/// Contains every hit that rays may have with what object `child` holds, placed by `to_parent`;
/// empty for an empty tree. The child is built, and so are all below. `error` is the growth of
/// rounding errors at this placement, as in ObjectRecord::origin_error. Coordinates of more than
/// 1e15 may come back infinite.
PlacedBox placed_box(const Content& content, std::uint32_t child, const Transform& to_parent,
                     float error);

/// Returns the box of all vertices of the last object as its instances place them, rounded to
/// float32 and not padded: the size that a scene has for people. Records count with their boxes.
/// Where ten thousands of placements reach equally far, their padded boxes count.
Box scene_bounds(const Content& content);

}  // namespace raynest
