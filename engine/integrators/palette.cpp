#include "engine/integrators/palette.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

namespace raynest {
namespace {

// Ten evenly spaced colours each, joined by straight lines in sRGB: no step is visible at 256
// levels. viridis and inferno: Smith and van der Walt, "A better default colormap for matplotlib"
// (2015); turbo: Mikhailov, "Turbo, an improved rainbow colormap for visualization" (2019).
constexpr std::array<std::uint32_t, 10> turbo{0x30123b, 0x4662d7, 0x36aaf9, 0x1ae4b6, 0x72fe5e,
                                              0xc7ef34, 0xfaba39, 0xf66b19, 0xcb2a04, 0x7a0403};
constexpr std::array<std::uint32_t, 10> viridis{0x440154, 0x482878, 0x3e4a89, 0x31688e, 0x26828e,
                                                0x1f9e89, 0x35b779, 0x6dcd59, 0xb4de2c, 0xfde725};
constexpr std::array<std::uint32_t, 10> inferno{0x000004, 0x1b0c42, 0x4b0c6b, 0x781c6d, 0xa52c60,
                                                0xcf4446, 0xed6925, 0xfb9a06, 0xf7d03c, 0xfcffa4};
constexpr std::array<std::uint32_t, 2> gray{0x000000, 0xffffff};

struct Anchors {
    std::string_view name;
    std::span<const std::uint32_t> colours;
};
constexpr std::array<Anchors, 4> palettes{{
    {"turbo", turbo},
    {"viridis", viridis},
    {"inferno", inferno},
    {"gray", gray},
}};

Palette interpolate(std::span<const std::uint32_t> anchors) {
    Palette palette;
    for (std::size_t i = 0; i < palette.size(); ++i) {
        const std::size_t scaled = i * (anchors.size() - 1);
        const std::size_t left = std::min(scaled / (palette.size() - 1), anchors.size() - 2);
        const std::size_t weight = scaled - left * (palette.size() - 1);
        const auto channel = [&](unsigned shift) {
            const std::size_t a = anchors[left] >> shift & 0xFF;
            const std::size_t b = anchors[left + 1] >> shift & 0xFF;
            return static_cast<std::uint8_t>((a * (palette.size() - 1 - weight) + b * weight) /
                                             (palette.size() - 1));
        };
        palette[i] = {channel(16), channel(8), channel(0)};
    }
    return palette;
}

}  // namespace

Result<Palette> find_palette(std::string_view name) {
    std::string known;
    for (const Anchors& palette : palettes) {
        if (palette.name == name) return interpolate(palette.colours);
        known += (known.empty() ? "" : ", ") + std::string(palette.name);
    }
    return fail(ErrorCode::param_invalid,
                "there is no palette '" + std::string(name) + "'; known: " + known);
}

}  // namespace raynest
