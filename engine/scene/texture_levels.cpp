#include "engine/scene/texture_levels.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace raynest {
namespace {

/// Linear light in 16 bits, and back: a table of the middle of each step is exact to a byte.
struct Light {
    std::array<std::uint16_t, 256> of_byte{};
    std::array<std::uint8_t, 4096> byte_of{};  ///< by the square root of light, in 4096 steps

    Light() {
        for (std::size_t i = 0; i < of_byte.size(); ++i) {
            const double s = static_cast<double>(i) / 255;
            const double linear =
                s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
            of_byte[i] = static_cast<std::uint16_t>(linear * 65535 + 0.5);
        }
        for (std::size_t i = 0; i < byte_of.size(); ++i) {
            const double root = (static_cast<double>(i) + 0.5) / static_cast<double>(byte_of.size());
            const double linear = root * root;
            const double s =
                linear <= 0.0031308 ? linear * 12.92 : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
            byte_of[i] = static_cast<std::uint8_t>(std::clamp(s, 0.0, 1.0) * 255 + 0.5);
        }
    }
    [[nodiscard]] std::uint8_t to_byte(double linear) const {
        const double root = std::sqrt(std::clamp(linear / 65535, 0.0, 1.0));
        return byte_of[std::min(static_cast<std::size_t>(root * 4096), std::size_t{4095})];
    }
};

/// The pixels of a side that pixel i of the next level stands for: two, or three at an odd end.
struct Covered {
    std::uint32_t first, last;
    Covered(std::uint32_t i, std::uint32_t from, std::uint32_t to)
        : first(std::min(2 * i, from - 1)),
          last(i + 1 == to ? from - 1 : std::min(2 * i + 1, from - 1)) {}
};

}  // namespace

std::uint32_t level_count(std::uint32_t width, std::uint32_t height) {
    std::uint32_t count = 1;
    for (std::uint32_t side = std::max(width, height); side > 1; side /= 2) ++count;
    return count;
}

std::vector<std::uint8_t> smaller_levels(const ImageDescription& image, bool linear) {
    static const Light light;
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
            const Covered rows(y, h, height);
            for (std::uint32_t x = 0; x < width; ++x) {
                const Covered columns(x, w, width);
                std::array<std::uint64_t, 3> weighted{}, plain{};
                std::uint64_t alpha = 0;
                std::uint64_t count = 0;
                for (std::uint32_t row = rows.first; row <= rows.last; ++row) {
                    for (std::uint32_t column = columns.first; column <= columns.last; ++column) {
                        const std::uint8_t* p = from + 4 * (std::size_t{row} * w + column);
                        for (std::size_t c = 0; c < 3; ++c) {
                            const std::uint64_t value = linear ? p[c] : light.of_byte[p[c]];
                            plain[c] += value;
                            weighted[c] += value * p[3];
                        }
                        alpha += p[3];
                        ++count;
                    }
                }
                std::uint8_t* out = to + 4 * (std::size_t{y} * width + x);
                for (std::size_t c = 0; c < 3; ++c) {
                    if (linear) {
                        out[c] = static_cast<std::uint8_t>((plain[c] + count / 2) / count);
                        continue;
                    }
                    out[c] = light.to_byte(
                        alpha != 0 ? static_cast<double>(weighted[c]) / static_cast<double>(alpha)
                                   : static_cast<double>(plain[c]) / static_cast<double>(count));
                }
                out[3] = static_cast<std::uint8_t>((alpha + count / 2) / count);
            }
        });
        from = to;
        to += std::size_t{4} * width * height;
        w = width;
        h = height;
    }
    return levels;
}

}  // namespace raynest
