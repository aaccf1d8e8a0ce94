// Colours of text files, which do not say how far their numbers go.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string_view>
#include <vector>

namespace raynest {

/// A warning of readers that take the colours of vertices.
constexpr std::string_view face_colours_left_out =
    "the colours of its faces are left out: those of vertices are read";

/// A shade that the file leaves out.
constexpr float no_shade = std::numeric_limits<float>::quiet_NaN();

/// Returns a byte for each shade. All go to 1, or all to 255 where one is above 2: one vertex alone
/// does not tell, for 1 is the darkest grey but black of 255. A few above 1 are rounding.
inline std::vector<std::uint8_t> bytes_of_shades(const std::vector<float>& shades) {
    const float most =
        std::any_of(shades.begin(), shades.end(), [](float shade) { return shade > 2; }) ? 255 : 1;
    std::vector<std::uint8_t> bytes;
    bytes.reserve(shades.size());
    for (const float shade : shades) {
        const float share = std::isnan(shade) ? 1 : std::clamp(shade / most, 0.0F, 1.0F);
        bytes.push_back(static_cast<std::uint8_t>(std::lround(share * 255)));
    }
    return bytes;
}

}  // namespace raynest
