// Splits that cut triangles in two: for long ones whose boxes would overlap whatever goes where.
//
// Stich, Friedrich, Dietrich, "Spatial splits in bounding volume hierarchies" (2009): planes in
// space compete with splits of the list of items. A triangle that a plane cuts becomes two
// references, each with the box of its part; BinaryTree bounds their number (Range::room).
//
// Is a hit ever culled by a clipped box? A whole triangle's hits are held to its whole box
// (geometry/slabs.h), so boxes around it never cull them. A part's box has less to offer: the exact
// triangle lies in the union of its parts. A ray that is called a hit passes the exact triangle
// within a few roundings (2^-24) of the coordinates involved. Those of the ray's origin are in the
// box test's own allowance; for those of the triangle parts are padded by 2^-18 of its largest
// coordinate, 64 roundings. What is left is the ray that lies in the plane of a triangle but for
// rounding: it may be called a hit anywhere in the whole box, where no part need be. No padding is
// proof against it. Measured: 0 of 10^7 rays at edges and along planes differ from brute force,
// with this padding and with none; with boxes too small by 2^-14, 254 do (tests: spatial_test.cpp).
#pragma once

#include "engine/bvh/build.h"
#include "engine/bvh/build_items.h"
#include "engine/bvh/build_split.h"

#include <cstdint>
#include <optional>

namespace raynest::build {

struct SpatialSplit {
    int axis = -1;
    float cost = std::numeric_limits<float>::infinity();  ///< as ObjectSplit's
    float plane = 0;
    Extent left = Extent::none(), right = Extent::none();
    std::uint32_t left_count = 0, right_count = 0;
};

/// The cheapest of a few planes on each axis.
SpatialSplit find_spatial_split(const Item* items, const Range& range, const Extent& box,
                                std::span<const Corners> corners, std::uint32_t block_items);

/// Nothing, and nothing changed, when the range has no room for the parts or a side gets them all.
std::optional<Halves> split_in_space(Item* items, const Range& range, const SpatialSplit& split,
                                     std::span<const Corners> corners);

}  // namespace raynest::build
