// Where to split a range of items in two: binned surface area heuristic.
//
// Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007): centres fall into
// equal bins on each axis, and the planes between bins are the candidates. Counts are counted in
// leaf blocks, as Embree does: near the leaves that fills blocks.
#pragma once

#include "engine/bvh/build_items.h"

#include <cstdint>

namespace raynest::build {

struct Loops;

/// Sorts centres into bins; the same arithmetic for four lanes and for one axis.
struct BinMap {
    Float4 origin, scale;
    int bins;

    BinMap(const Extent& centers, int bin_count);
    [[nodiscard]] Int4 bins_of(Float4 center) const {
        const float last = static_cast<float>(bins - 1);
        return __builtin_convertvector(
            minimum((center - origin) * scale, Float4{last, last, last, last}), Int4);
    }
};

struct ObjectSplit {
    int axis = -1;  ///< -1: no plane separates the centres, or areas overflow
    float cost = std::numeric_limits<float>::infinity();  ///< sum of area x blocks
    float origin = 0, scale = 0, plane = 0;  ///< left: (centre - origin) * scale < plane
    Extent left = Extent::none(), right = Extent::none();  ///< boxes of the sides

    [[nodiscard]] bool is_left(const Item& item) const {
        return (item.center(axis) - origin) * scale < plane;
    }
};

/// The two parts of a split range; `centers` bound the items' centres.
struct Halves {
    Range left, right;
    Extent left_centers, right_centers;
};

/// Left and right ranges of so many items; each gets its share of the free places.
Halves share_room(const Range& range, std::uint32_t left_count, std::uint32_t right_count);

/// `block_items`: how many items share the cost of one leaf block.
ObjectSplit find_object_split(const Item* items, std::uint32_t count, const Extent& centers,
                              std::uint32_t block_items, const Loops& loops);

/// Moves the left items to the front.
Halves partition(Item* items, const Range& range, const ObjectSplit& split, const Loops& loops);

/// The first `left_count` items against the rest.
Halves cut_at(Item* items, const Range& range, std::uint32_t left_count);

/// Equal halves along the widest axis of the centres; by id where all centres coincide.
Halves halve(Item* items, const Range& range, const Extent& centers);

}  // namespace raynest::build
