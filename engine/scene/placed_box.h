// The box that an instance gets in its parent's tree.
//
// The eight corners of the child's box are the wrong thing to turn: a disc's square, turned by 45
// degrees, has twice the area, and every level of nesting adds its own. What counts is how far the
// child itself reaches along the parent's axes, which its tree answers.
#pragma once

#include "engine/bvh/build.h"
#include "engine/geometry/box.h"
#include "engine/math/vec.h"

namespace raynest {

/// Contains every hit that rays may have with what `child` holds, placed by `to_parent`; empty for
/// an empty tree. `error` is the growth of rounding errors at this placement, as in
/// ObjectRecord::origin_error. Coordinates of more than 1e15 may come back infinite.
Box placed_box(const Tree& child, const Transform& to_parent, float error);

}  // namespace raynest
