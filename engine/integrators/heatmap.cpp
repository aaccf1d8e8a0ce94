// Counts -> colours; the legend says which is which.
#include "engine/integrators/legend.h"
#include "engine/integrators/palette.h"
#include "engine/integrators/picture.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <type_traits>
#include <vector>

namespace raynest {

std::optional<CameraHits> measure_work(const PixelRange& pixels, const ColumnSource& scene,
                                       RayCaster& caster, const PixelArrays& arrays,
                                       std::span<const Column> metrics, bool necessary,
                                       std::span<std::uint32_t> out) {
    const std::span<Ray> rays = arrays.rays.first(pixels.rays());
    const std::span<HitRecord> hits = arrays.hits.first(rays.size());
    const std::span<Counters> counters = arrays.counters.first(rays.size() * arrays.counter_sets);
    generate_samples(pixels.camera, pixels.samples, pixels.first, rays, pixels.window);
    // Necessary work is what lies before the hit: with tmax there, order no longer matters.
    if (necessary) {
        if (!caster.closest(rays, hits)) return std::nullopt;
        for (std::size_t i = 0; i < rays.size(); ++i)
            if (hits[i].hit != 0) rays[i].tmax = hits[i].t;
    }
    if (!caster.counted(rays, hits, counters)) return std::nullopt;

    ColumnSource source = scene;
    source.rays = rays;
    source.hits = hits;
    source.counters = counters;
    source.counter_sets = arrays.counter_sets;
    std::vector<std::uint32_t> counts(rays.size());
    for (std::size_t m = 0; m < metrics.size(); ++m) {
        if (metrics[m].of_level() && metrics[m].level >= arrays.counter_sets) {
            std::ranges::fill(out.subspan(m * pixels.count, pixels.count), 0U);
            continue;
        }
        write_column(metrics[m], source, reinterpret_cast<std::byte*>(counts.data()));
        for (std::size_t i = 0; i < pixels.count; ++i) {
            const auto first = counts.begin() + static_cast<std::ptrdiff_t>(i * pixels.samples);
            out[m * pixels.count + i] = std::accumulate(first, first + pixels.samples, 0U);
        }
    }
    return count_hits(hits);
}

std::optional<CameraHits> measure_time(const PixelRange& pixels, RayCaster& caster,
                                       const PixelArrays& arrays, const PixelTimes& out,
                                       double& spread) {
    const std::span<Ray> rays = arrays.rays.first(pixels.rays());
    const std::span<HitRecord> hits = arrays.hits.first(rays.size());
    generate_samples(pixels.camera, pixels.samples, pixels.first, rays, pixels.window);
    std::vector<std::uint32_t> times(rays.size());
    std::vector<std::uint32_t> noises(rays.size());
    const auto measured = caster.timed(rays, hits, times, noises);
    if (!measured) return std::nullopt;
    spread = *measured;
    for (std::size_t i = 0; i < pixels.count; ++i) {
        const std::size_t first = i * pixels.samples;
        out.nanoseconds[i] = 0;
        double squares = 0;
        for (std::size_t k = first; k < first + pixels.samples; ++k) {
            out.nanoseconds[i] += times[k];
            squares += static_cast<double>(noises[k]) * noises[k];
        }
        out.noise[i] = static_cast<std::uint32_t>(std::min(std::round(std::sqrt(squares)), 4e9));
    }
    return count_hits(hits);
}

namespace {

template <class Value>
Result<Picture> draw(std::uint32_t width, std::uint32_t height, std::span<const Value> counts,
                     const HeatStatistics& statistics, const HeatOptions& options) {
    if (width == 0 || height == 0 || counts.size() != std::size_t{width} * height) {
        return fail(ErrorCode::param_invalid, "a heat map needs one count per pixel");
    }
    const auto palette = find_palette(options.palette);
    if (!palette) return tl::unexpected(palette.error());

    const HeatScale scale{statistics.range_low, statistics.range_high, options.scale == "log",
                          std::is_signed_v<Value>};
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
    append_legend(picture, *palette, scale, statistics, options);
    return picture;
}

}  // namespace

Result<Picture> heat_picture(std::uint32_t width, std::uint32_t height,
                             std::span<const std::uint32_t> counts,
                             const HeatStatistics& statistics, const HeatOptions& options) {
    return draw(width, height, counts, statistics, options);
}

Result<Picture> heat_picture(std::uint32_t width, std::uint32_t height,
                             std::span<const std::int32_t> differences,
                             const HeatStatistics& statistics, const HeatOptions& options) {
    return draw(width, height, differences, statistics, options);
}

}  // namespace raynest
