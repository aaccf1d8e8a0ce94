#include "engine/bvh/build_morton.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <bit>
#include <utility>
#include <vector>

namespace raynest::build {
namespace {

// Cells are cubes, 1024 along the longest side: flat scenes are not cut into layers.
constexpr float cells_per_side = 1024;
constexpr std::uint32_t digit_bits = 10;
constexpr std::uint32_t digit_count = 1U << digit_bits;

/// Bits 0..9 to every third place.
std::uint32_t spread(std::int32_t cell) {
    auto x = static_cast<std::uint32_t>(cell);
    x = (x | x << 16) & 0x030000FFU;
    x = (x | x << 8) & 0x0300F00FU;
    x = (x | x << 4) & 0x030C30C3U;
    x = (x | x << 2) & 0x09249249U;
    return x;
}

struct Place {
    std::uint32_t code, item;
};

/// Items that one task sorts; each part counts all digits.
std::uint32_t part_of(std::uint32_t count) {
    constexpr std::uint32_t parts_max = 16;
    return std::max(part_items, count / parts_max + 1);
}

template <class Body>
void for_each_part(std::uint32_t count, const Body& body) {
    const std::uint32_t size = part_of(count);
    tbb::parallel_for(0U, (count + size - 1) / size, [&](std::uint32_t part) {
        const std::uint32_t first = part * size;
        body(part, first, std::min(first + size, count));
    });
}

/// One pass of a radix sort: stable, so passes add up and threads do not matter.
void sort_by_digit(const PageVector<Place>& from, PageVector<Place>& to, std::uint32_t count,
                   std::uint32_t shift) {
    const auto digit_of = [&](std::uint32_t i) {
        return from[i].code >> shift & (digit_count - 1);
    };
    std::vector<std::array<std::uint32_t, digit_count>> next(count / part_of(count) + 1);
    for_each_part(count, [&](std::uint32_t part, std::uint32_t i, std::uint32_t end) {
        for (; i < end; ++i) ++next[part][digit_of(i)];
    });
    std::uint32_t sum = 0;
    for (std::uint32_t digit = 0; digit < digit_count; ++digit) {
        for (auto& part : next) sum += std::exchange(part[digit], sum);
    }
    for_each_part(count, [&](std::uint32_t part, std::uint32_t i, std::uint32_t end) {
        for (; i < end; ++i) to[next[part][digit_of(i)]++] = from[i];
    });
}

}  // namespace

MortonOrder::MortonOrder(Item* items, std::uint32_t count, const Extent& centers) : codes_(count) {
    const Float4 size = centers.size();
    const float longest = std::max({size[0], size[1], size[2]});
    const float scale = cells_per_side / std::max(longest, std::numeric_limits<float>::min());
    constexpr float last = cells_per_side - 1;
    PageVector<Place> places(count), sorted(count);
    PageVector<Item> unsorted(count);
    for_each_part(count, [&](std::uint32_t, std::uint32_t i, std::uint32_t end) {
        for (; i < end; ++i) {
            const Float4 at = (items[i].center() + centers.minus_lower) * scale;
            const Int4 cell =
                __builtin_convertvector(minimum(at, Float4{last, last, last, last}), Int4);
            places[i] = {spread(cell[0]) << 2 | spread(cell[1]) << 1 | spread(cell[2]), i};
            unsorted[i] = items[i];
        }
    });
    sort_by_digit(places, sorted, count, 0);
    sort_by_digit(sorted, places, count, digit_bits);
    sort_by_digit(places, sorted, count, 2 * digit_bits);
    for_each_part(count, [&](std::uint32_t, std::uint32_t i, std::uint32_t end) {
        for (; i < end; ++i) {
            items[i] = unsorted[sorted[i].item];
            codes_[i] = sorted[i].code;
        }
    });
}

std::uint32_t MortonOrder::left_count(const Range& range) const {
    const std::uint32_t* const first = codes_.data() + range.first;
    const std::uint32_t* const last = first + range.count - 1;
    if (*first == *last) return 0;
    const std::uint32_t highest = std::bit_floor(*first ^ *last);
    const std::uint32_t* const right = std::partition_point(
        first, last, [highest](std::uint32_t code) { return (code & highest) == 0; });
    return static_cast<std::uint32_t>(right - first);
}

}  // namespace raynest::build
