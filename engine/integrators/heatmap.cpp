// Counts -> colours; the legend says which is which.
#include "engine/integrators/legend.h"
#include "engine/integrators/palette.h"
#include "engine/integrators/picture.h"

#include <cmath>
#include <cstddef>

namespace raynest {

Result<Picture> heat_picture(std::uint32_t width, std::uint32_t height,
                             std::span<const std::uint32_t> counts,
                             const HeatStatistics& statistics, const HeatOptions& options) {
    if (width == 0 || height == 0 || counts.size() != std::size_t{width} * height) {
        return fail(ErrorCode::param_invalid, "a heat map needs one count per pixel");
    }
    const auto palette = find_palette(options.palette);
    if (!palette) return tl::unexpected(palette.error());

    const HeatScale scale{statistics.range_low, statistics.range_high, options.scale == "log"};
    Picture picture{width, height, {}};
    picture.rgba.resize(4 * counts.size());
    for (std::size_t i = 0; i < counts.size(); ++i) {
        const double position = scale.position(static_cast<double>(counts[i]));
        const auto step = static_cast<std::size_t>(
            std::lround(position * static_cast<double>(palette->size() - 1)));
        const Colour colour = (*palette)[step];
        std::uint8_t* pixel = &picture.rgba[4 * i];
        pixel[0] = colour.r;
        pixel[1] = colour.g;
        pixel[2] = colour.b;
        pixel[3] = 255;
    }
    append_legend(picture, *palette, scale, statistics, options.metric);
    return picture;
}

}  // namespace raynest
