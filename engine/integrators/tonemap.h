// Linear radiance -> what a screen shows: exposure, then a tone map.
#pragma once

#include "engine/integrators/film.h"
#include "engine/integrators/picture.h"
#include "engine/result.h"

#include <cstdint>
#include <optional>
#include <string_view>

namespace raynest {

enum class ToneMap : std::uint8_t {
#define RAYNEST_TONEMAP(name, text) name,
#include "engine/integrators/tonemaps.def"
};

/// How a picture is shown.
struct Look {
    ToneMap tonemap = ToneMap::none;
    std::optional<float> exposure = 0.0F;  ///< stops; nothing: auto_exposure()
};
inline constexpr float exposure_stops_max = 64;  ///< either way

/// Fails with param_invalid, naming the choices.
Result<ToneMap> parse_tonemap(std::string_view name);
/// "auto" or a number of stops; fails with param_invalid.
Result<std::optional<float>> parse_exposure(std::string_view text);

/// The stops that put the mean brightness of what is lit at middle grey: the mean of the logarithm,
/// of what lies between the darkest and the brightest 5 % of the pixels that show surfaces. What
/// lies behind them counts only in a picture whose surfaces are all black or absent. 0 for a black
/// picture.
[[nodiscard]] float auto_exposure(const Film& film);

/// 8-bit sRGB of a window of a film; transparent where A is 0. Premultiplied colours are divided by
/// alpha first, except where alpha is 0 and light is seen nevertheless.
struct Window {
    std::uint32_t x = 0, y = 0, width = 0, height = 0;
};
[[nodiscard]] Picture show(const Film& film, const Window& window, ToneMap tonemap, float stops);

}  // namespace raynest
