#include "engine/integrators/palette.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

namespace raynest {
namespace {

/// Names of rows, apart from those of the files that this one is compiled together with.
namespace rows {
#define RAYNEST_PALETTE(name, ...) constexpr std::uint32_t name[] = {__VA_ARGS__};
#include "engine/integrators/palettes.def"
}  // namespace rows

struct Anchors {
    std::string_view name;
    std::span<const std::uint32_t> colours;
};
constexpr std::array palettes = {
#define RAYNEST_PALETTE(name, ...) Anchors{#name, rows::name},
#include "engine/integrators/palettes.def"
};

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
