// The loops in which a build spends most of its time, compiled for several targets.
//
// All targets give the same bits: maxima, minima and counts do not depend on order, and costs are
// computed lane by lane by the same operations.
#pragma once

#include "engine/bvh/build_split.h"

#include <algorithm>
#include <cstdint>
#include <span>

namespace raynest::build {

// 32 bins instead of 16: +34 % of build time, -0.5 % of SAH cost, no speed.
inline constexpr int bins_max = 16;

/// The boxes and numbers of the items in each bin, on each axis.
struct Bins {
    Extent box[bins_max][3];
    std::int32_t count[bins_max][4];  // lane 3 stays 0

    explicit Bins(int bins) {
        for (int b = 0; b < bins; ++b) {
            for (Extent& e : box[b]) e = Extent::none();
            std::fill_n(count[b], 4, 0);
        }
    }
    void join(const Bins& other, int bins) {
        for (int b = 0; b < bins; ++b) {
            for (int axis = 0; axis < 3; ++axis) {
                box[b][axis].extend(other.box[b][axis]);
                count[b][axis] += other.count[b][axis];
            }
        }
    }
};

/// The result of a pass of a partition.
struct SidePass {
    std::uint32_t left = 0;
    Extent left_centers = Extent::none(), right_centers = Extent::none();

    void join(const SidePass& other) {
        left += other.left;
        left_centers.extend(other.left_centers);
        right_centers.extend(other.right_centers);
    }
};

struct Loops {
    const char* target;
    void (*bin)(Bins& bins, const Item* items, std::uint32_t count, const BinMap& map);
    /// The same for boxes of several items; `sizes` are their numbers, by the id of the box.
    void (*bin_cells)(Bins& bins, const Item* cells, std::uint32_t count, const BinMap& map,
                      const std::uint32_t* sizes);
    /// The cheapest plane between two bins.
    ObjectSplit (*cheapest)(const Bins& bins, const BinMap& map, std::uint32_t block_items);
    /// Moves the left items to the front.
    SidePass (*partition)(Item* items, std::uint32_t count, const ObjectSplit& split);
};

/// Those that this CPU can run: the baseline first, the fastest last.
std::span<const Loops> loops();

}  // namespace raynest::build
