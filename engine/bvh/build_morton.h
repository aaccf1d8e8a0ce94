// Items along a space-filling curve: where a fast build splits.
//
// Lauterbach et al., "Fast BVH construction on GPUs" (2009): centres are numbered by the cell of a
// grid that they lie in, bits of the axes interleaved; sorted by that number, every range splits
// where the highest bit changes. One sort replaces the passes of all levels. What shares a cell is
// left to the binned splits.
#pragma once

#include "engine/bvh/build_items.h"

#include <cstdint>

namespace raynest::build {

class MortonOrder {
public:
    /// Sorts the items.
    MortonOrder(Item* items, std::uint32_t count, const Extent& centers);

    /// Items of the range before the change of the highest bit; 0 when all share one cell.
    [[nodiscard]] std::uint32_t left_count(const Range& range) const;

private:
    PageVector<std::uint32_t> codes_;
};

}  // namespace raynest::build
