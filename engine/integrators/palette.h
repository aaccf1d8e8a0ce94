// Colour scales of heat maps.
#pragma once

#include "engine/integrators/font.h"
#include "engine/result.h"

#include <array>
#include <string_view>

namespace raynest {

/// 256 colours from low to high, 8-bit sRGB.
using Palette = std::array<Colour, 256>;

/// Returns a palette of palettes.def; param_invalid with the list of names otherwise.
Result<Palette> find_palette(std::string_view name);

}  // namespace raynest
