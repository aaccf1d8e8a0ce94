// Smaller copies of a picture, each half as wide and high as the one before, down to one pixel.
#pragma once

#include "engine/scene/description.h"

#include <cstdint>
#include <vector>

namespace raynest {

/// Returns the byte of sRGB's curve that is nearest to linear light in [0, 1].
[[nodiscard]] std::uint8_t srgb_byte(float linear);

/// Levels of a picture, itself included.
[[nodiscard]] std::uint32_t level_count(std::uint32_t width, std::uint32_t height);

/// The levels from the second on, one behind the other. A pixel is the mean of those that it stands
/// for: of colours in linear light, weighted by alpha, so that what is invisible leaves no fringe;
/// of data byte by byte.
[[nodiscard]] std::vector<std::uint8_t> smaller_levels(const ImageDescription& image, bool linear);

}  // namespace raynest
