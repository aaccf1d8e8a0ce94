#include "engine/bvh/build_split.h"

#include "engine/bvh/build_loops.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

namespace raynest::build {
namespace {

// Small ranges have few candidates anyway.
constexpr int bins_few = 8;
constexpr std::uint32_t few_items = 64;

// Maxima and whole sums: the order in which parts are joined does not matter.
void fill(Bins& bins, const Item* items, std::uint32_t count, const BinMap& map,
          const Loops& loops) {
    if (count < wide_items) return loops.bin(bins, items, count, map);
    using Part = tbb::blocked_range<std::uint32_t>;
    bins = tbb::parallel_reduce(
        Part(0, count, part_items), bins,
        [&](const Part& part, Bins some) {
            loops.bin(some, items + part.begin(), part.end() - part.begin(), map);
            return some;
        },
        [&](Bins a, const Bins& b) {
            a.join(b, map.bins);
            return a;
        });
}

/// Parts are partitioned by themselves; then what lies on the wrong side of the whole is exchanged,
/// run by run.
SidePass partition_wide(Item* items, std::uint32_t count, const ObjectSplit& split,
                        const Loops& loops) {
    const std::uint32_t parts = (count + part_items - 1) / part_items;
    std::vector<SidePass> sides(parts);
    tbb::parallel_for(0U, parts, [&](std::uint32_t p) {
        const std::uint32_t first = p * part_items;
        sides[p] = loops.partition(items + first, std::min(part_items, count - first), split);
    });
    SidePass all;
    for (const SidePass& side : sides) all.join(side);

    struct Run {
        std::uint32_t first, count;
    };
    std::vector<Run> rights, lefts;  // right items in front of the border, left items behind it
    const auto add = [](std::vector<Run>& runs, std::uint32_t first, std::uint32_t end) {
        if (first < end) runs.push_back({first, end - first});
    };
    for (std::uint32_t p = 0; p < parts; ++p) {
        const std::uint32_t first = p * part_items;
        const std::uint32_t border = first + sides[p].left;
        add(rights, border, std::min({first + part_items, count, all.left}));
        add(lefts, std::max(first, all.left), border);
    }
    struct Exchange {
        std::uint32_t a, b, count;
    };
    std::vector<Exchange> exchanges;
    for (std::size_t r = 0, l = 0; r < rights.size();) {
        const std::uint32_t n = std::min(rights[r].count, lefts[l].count);
        exchanges.push_back({rights[r].first, lefts[l].first, n});
        rights[r] = {rights[r].first + n, rights[r].count - n};
        lefts[l] = {lefts[l].first + n, lefts[l].count - n};
        if (rights[r].count == 0) ++r;
        if (lefts[l].count == 0) ++l;
    }
    tbb::parallel_for(std::size_t{0}, exchanges.size(), [&](std::size_t i) {
        const Exchange& e = exchanges[i];
        std::swap_ranges(items + e.a, items + e.a + e.count, items + e.b);
    });
    return all;
}

/// Moves the right items of a range, which follow its left ones, to where their room begins.
Halves place_halves(Item* items, const Range& range, std::uint32_t left_count) {
    const Halves halves = share_room(range, left_count, range.count - left_count);
    if (halves.left.room != left_count) {
        std::copy_backward(items + range.first + left_count, items + range.first + range.count,
                           items + halves.right.first + halves.right.count);
    }
    return halves;
}

}  // namespace

Halves share_room(const Range& range, std::uint32_t left_count, std::uint32_t right_count) {
    const std::uint32_t count = left_count + right_count;
    const std::uint64_t free = range.room - count;
    const std::uint32_t left_room =
        left_count + static_cast<std::uint32_t>(free * left_count / count);
    return {{range.first, left_count, left_room},
            {range.first + left_room, right_count, range.room - left_room},
            Extent::none(),
            Extent::none()};
}

BinMap::BinMap(const Extent& centers, int bin_count)
    : origin(-centers.minus_lower),
      bins(bin_count) {
    const Float4 size = centers.size();
    scale = Float4{};
    origin[3] = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const float s = static_cast<float>(bin_count) / size[axis];
        if (size[axis] > 0 && std::isfinite(s)) scale[axis] = s;
    }
}

ObjectSplit find_object_split(const Item* items, std::uint32_t count, const Extent& centers,
                              std::uint32_t block_items, const Loops& loops) {
    const BinMap map(centers, count < few_items ? bins_few : bins_max);
    Bins bins(map.bins);
    fill(bins, items, count, map, loops);
    return loops.cheapest(bins, map, block_items);
}

Halves partition(Item* items, const Range& range, const ObjectSplit& split, const Loops& loops) {
    Item* const first = items + range.first;
    const SidePass sides = range.count < wide_items
                               ? loops.partition(first, range.count, split)
                               : partition_wide(first, range.count, split, loops);
    Halves halves = place_halves(items, range, sides.left);
    halves.left_centers = sides.left_centers;
    halves.right_centers = sides.right_centers;
    return halves;
}

Halves halve(Item* items, const Range& range, const Extent& centers) {
    const Float4 size = centers.size();
    const int axis = size[0] >= size[1] && size[0] >= size[2] ? 0 : size[1] >= size[2] ? 1 : 2;
    Item* const begin = items + range.first;
    std::nth_element(begin, begin + range.count / 2, begin + range.count,
                     [axis](const Item& a, const Item& b) {
                         const float ca = a.center(axis), cb = b.center(axis);
                         if (ca != cb) return ca < cb;
                         if (a.id() != b.id()) return a.id() < b.id();
                         return a.extent.upper[axis] < b.extent.upper[axis];
                     });
    return cut_at(items, range, range.count / 2);
}

Halves cut_at(Item* items, const Range& range, std::uint32_t left_count) {
    Halves halves = place_halves(items, range, left_count);
    halves.left_centers = centers_of(items + halves.left.first, halves.left.count);
    halves.right_centers = centers_of(items + halves.right.first, halves.right.count);
    return halves;
}

}  // namespace raynest::build
