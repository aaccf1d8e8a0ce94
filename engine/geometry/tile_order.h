// The order in which pictures are traced, so that rays next to each other look the same way.
#pragma once

#include "engine/math/vec.h"

#include <algorithm>
#include <cstdint>

namespace raynest {

/// The order in which pictures are traced: tiles of 8 x 8 pixels made of four of 4 x 4, so that 64
/// rays in a row look the same way, and 16 even more so, as coherent packets need. What is left on
/// the right and at the bottom comes column by column. Gives the pixel, row by row with y down,
/// that comes `place`-th in a picture of width x height.
[[nodiscard]] RAYNEST_FN inline std::uint64_t tile_order(std::uint64_t place, std::uint64_t width,
                                                         std::uint64_t height) {
    const std::uint64_t band = place / (8 * width);
    const std::uint64_t within = place % (8 * width);
    const std::uint64_t rows = std::min<std::uint64_t>(8, height - 8 * band);
    const std::uint64_t tile = within / 64;
    std::uint64_t x = within / rows;
    std::uint64_t y = within % rows;
    if (rows == 8 && 8 * (tile + 1) <= width) {
        const std::uint64_t i = within % 64;
        x = 8 * tile + i / 16 % 2 * 4 + i % 4;
        y = i / 32 * 4 + i / 4 % 4;
    }
    return (8 * band + y) * width + x;
}

/// Calls f(i, x, y) for the `count` places from `first` on, i from 0; as tile_order(), at the cost
/// of one division per tile.
template <class F>
void for_each_in_tiles(std::uint64_t first, std::uint64_t count, std::uint64_t width,
                       std::uint64_t height, F&& f) {
    for (std::uint64_t i = 0; i < count;) {
        const std::uint64_t place = first + i;
        const std::uint64_t band = place / (8 * width);
        const std::uint64_t within = place % (8 * width);
        const bool whole = within % 64 == 0 && within / 8 + 8 <= width && 8 * band + 8 <= height;
        if (!whole || count - i < 64) {
            const std::uint64_t pixel = tile_order(place, width, height);
            f(i, pixel % width, pixel / width);
            ++i;
            continue;
        }
        for (std::uint64_t k = 0; k < 64; ++k, ++i) {
            f(i, within / 8 + k / 16 % 2 * 4 + k % 4, 8 * band + k / 32 * 4 + k / 4 % 4);
        }
    }
}

}  // namespace raynest
