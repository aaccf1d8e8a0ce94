#include "engine/scene/texture_levels.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace raynest {
namespace {

/// Linear light in 16 bits, and back.
struct Light {
    std::array<std::uint16_t, 256> of_byte{};
    std::array<std::uint8_t, 65536> byte_of{};

    Light() {
        const auto linear = [](double s) {
            return 65535 * (s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4));
        };
        for (std::size_t i = 0; i < of_byte.size(); ++i)
            of_byte[i] = static_cast<std::uint16_t>(linear(static_cast<double>(i) / 255) + 0.5);
        auto* next = byte_of.begin();
        for (std::size_t i = 0; i < of_byte.size(); ++i) {
            const double end =
                i == 255 ? 65536 : std::ceil(linear((static_cast<double>(i) + 0.5) / 255));
            auto* const last = byte_of.begin() + static_cast<std::ptrdiff_t>(end);
            std::fill(next, last, static_cast<std::uint8_t>(i));
            next = last;
        }
    }
};

const Light& light_table() {
    static const Light light;
    return light;
}

/// The pixels of a side that pixel i of the next level stands for: two, or three at an odd end.
struct Covered {
    std::uint32_t first, last;
};
Covered covered(std::uint32_t i, std::uint32_t from, std::uint32_t to) {
    return {std::min(2 * i, from - 1), i + 1 == to ? from - 1 : std::min(2 * i + 1, from - 1)};
}

}  // namespace

std::uint8_t srgb_byte(float linear) {
    return light_table().byte_of[static_cast<std::size_t>(linear * 65535.0F + 0.5F)];
}

std::uint32_t level_count(std::uint32_t width, std::uint32_t height) {
    std::uint32_t count = 1;
    for (std::uint32_t side = std::max(width, height); side > 1; side /= 2) ++count;
    return count;
}

namespace {

/// The mean of the pixels of a level, `width` wide, that rows and columns name. Always inlined:
/// where the caller knows the counts, nothing is left to loop over.
template <bool linear>
[[gnu::always_inline]] inline void write_mean(const Light& light, const std::uint8_t* from,
                                              std::uint32_t width, const Covered& rows,
                                              const Covered& columns, std::uint8_t* out) {
    std::array<std::uint32_t, 3> weighted{}, plain{};  // at most 9 * 255 * 65535
    std::uint32_t alpha = 0;
    for (std::uint32_t row = rows.first; row <= rows.last; ++row) {
        const std::uint8_t* p = from + 4 * (std::size_t{row} * width + columns.first);
        for (std::uint32_t column = columns.first; column <= columns.last; ++column, p += 4) {
            for (std::size_t c = 0; c < 3; ++c) {
                const std::uint32_t value = linear ? p[c] : light.of_byte[p[c]];
                plain[c] += value;
                if (!linear) weighted[c] += value * p[3];
            }
            alpha += p[3];
        }
    }
    const std::uint32_t count = (rows.last - rows.first + 1) * (columns.last - columns.first + 1);
    const bool all_or_none = alpha == 0 || alpha == 255 * count;
    const auto mean = [count](std::uint32_t sum) { return (sum + count / 2) / count; };
    for (std::size_t c = 0; c < 3; ++c) {
        const std::uint32_t value =
            linear || all_or_none ? mean(plain[c]) : (weighted[c] + alpha / 2) / alpha;
        out[c] = linear ? static_cast<std::uint8_t>(value) : light.byte_of[value];
    }
    out[3] = static_cast<std::uint8_t>(mean(alpha));
}

template <bool linear>
void write_row(const Light& light, const std::uint8_t* from, std::uint32_t w, const Covered& rows,
               std::uint32_t width, std::uint8_t* out) {
    const bool pairs = w == 2 * width && rows.last == rows.first + 1;
    if (pairs) {
        for (std::uint32_t x = 0; x < width; ++x, out += 4)
            write_mean<linear>(light, from + 4 * (std::size_t{rows.first} * w + 2 * x), w, {0, 1},
                               {0, 1}, out);
        return;
    }
    for (std::uint32_t x = 0; x < width; ++x, out += 4)
        write_mean<linear>(light, from, w, rows, covered(x, w, width), out);
}

}  // namespace

std::vector<std::uint8_t> smaller_levels(const ImageDescription& image, bool linear) {
    const Light& light = light_table();
    std::size_t total = 0;
    for (std::uint32_t w = image.width, h = image.height; w > 1 || h > 1;) {
        w = std::max(w / 2, 1U);
        h = std::max(h / 2, 1U);
        total += std::size_t{4} * w * h;
    }
    std::vector<std::uint8_t> levels(total);
    const std::uint8_t* from = image.rgba.data();
    std::uint8_t* to = levels.data();
    for (std::uint32_t w = image.width, h = image.height; w > 1 || h > 1;) {
        const std::uint32_t width = std::max(w / 2, 1U);
        const std::uint32_t height = std::max(h / 2, 1U);
        tbb::parallel_for(std::uint32_t{0}, height, [&](std::uint32_t y) {
            std::uint8_t* out = to + 4 * std::size_t{y} * width;
            (linear ? write_row<true> : write_row<false>)(light, from, w, covered(y, h, height),
                                                          width, out);
        });
        from = to;
        to += std::size_t{4} * width * height;
        w = width;
        h = height;
    }
    return levels;
}

}  // namespace raynest
