// A picture as it leaves an integrator, and the two kinds made in this folder.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/integrators/generators.h"
#include "engine/integrators/ray_caster.h"
#include "engine/queries/columns.h"
#include "engine/result.h"

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest {

/// 8-bit sRGB with straight alpha, row 0 on top.
struct Picture {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::vector<std::uint8_t> rgba;
};

/// Pixels of a camera's picture, in the tile order of a window of it, and how many rays each has.
struct PixelRange {
    const Sensor& camera;
    std::uint64_t first = 0;
    std::uint64_t count = 0;
    std::uint32_t samples = 1;
    PixelWindow window = {};
    [[nodiscard]] std::uint64_t rays() const { return count * samples; }
};

/// Room for the rays of a range of pixels and their hits.
struct PixelArrays {
    std::span<Ray> rays;
    std::span<HitRecord> hits;
    std::span<Counters> counters;  ///< for measure_work() only: `counter_sets` per ray
    std::uint32_t counter_sets = 1;
};

/// The hits of the camera rays of some pixels.
struct CameraHits {
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    std::uint64_t backs = 0;  ///< hits on the back of a surface
};

/// `--integrator primary`: base colour x |n.v|, background 0.18 grey with alpha 0. Linear RGBA,
/// the mean over the rays of a pixel. `scene` gives all but rays and hits. Nothing where the caster
/// has no answers.
[[nodiscard]] std::optional<CameraHits> render_primary(const PixelRange& pixels,
                                                       const ColumnSource& scene, RayCaster& caster,
                                                       const PixelArrays& arrays,
                                                       std::span<Vec4> out);
/// The colours that render_primary() takes the mean of: one per ray of the source (closest hits).
void shade_primary(const ColumnSource& source, std::span<Vec4> out);

/// Measures what a pixel's rays cost together, as the counters `metrics` count it: out[m * count +
/// i] of metric m and pixel i, 0 of a level that the scene lacks. `necessary`: only the work before
/// the hit, which no order of traversal saves. Nothing where the caster has no answers.
[[nodiscard]] std::optional<CameraHits> measure_work(const PixelRange& pixels,
                                                     const ColumnSource& scene, RayCaster& caster,
                                                     const PixelArrays& arrays,
                                                     std::span<const Column> metrics,
                                                     bool necessary, std::span<std::uint32_t> out);
/// The results of measure_time(), one of each pixel.
struct PixelTimes {
    std::span<std::uint32_t> nanoseconds;
    std::span<std::uint32_t> noise;  ///< the sum's, as if the rays' noises had nothing in common
};
/// Measures how long a pixel's rays take together. `spread` gets what RayCaster::timed() returns.
[[nodiscard]] std::optional<CameraHits> measure_time(const PixelRange& pixels, RayCaster& caster,
                                                     const PixelArrays& arrays,
                                                     const PixelTimes& out, double& spread);
/// The numbers of closest hits.
[[nodiscard]] CameraHits count_hits(std::span<const HitRecord> hits);

/// Linear RGBA -> 8-bit sRGB.
Picture to_picture(std::uint32_t width, std::uint32_t height, std::span<const Vec4> pixels);

/// Statistics over all pixels, misses included. Percentiles are exact (nearest rank).
struct HeatStatistics {
    std::int64_t min = 0, p50 = 0, p90 = 0, p99 = 0, max = 0;  ///< below 0 only of differences
    double mean = 0;
    double clipped = 0;  ///< share of pixels above the range
    double below = 0;    ///< share of pixels below it
    std::uint64_t rays = 0;
    double range_low = 0, range_high = 0;
};

/// The metrics of measures.def.
enum class Measure : std::uint8_t {
    none,
#define RAYNEST_MEASURE(name, title) name,
#include "engine/integrators/measures.def"
};

/// A heat map shows a counter, perhaps of one level, or a measure where there is one.
struct HeatMetric {
    Column counter = {};
    Measure measure = Measure::none;
    friend bool operator==(const HeatMetric&, const HeatMetric&) = default;
};
/// param_invalid, naming the choices: counters and those of measures.def.
Result<HeatMetric> parse_metric(const std::string& name);
[[nodiscard]] std::string metric_name(const HeatMetric& metric);

struct HeatOptions {
    std::string metric = "total";     ///< as parse_metric() reads it
    std::string palette = "turbo";    ///< a name in palettes.def
    std::string scale = "linear";     ///< linear | log
    std::string range = "p99";        ///< auto | p99 | a:b; of a difference -b:b
    std::string count = "traversed";  ///< traversed | necessary: for the legend alone
    /// For the legend alone: what the picture is of, such as a scene and a camera.
    std::vector<std::string> view = {};
};

/// Fails with param_invalid, naming the choices.
Result<HeatStatistics> heat_statistics(std::span<const std::uint32_t> counts,
                                       const HeatOptions& options);
/// The same of the differences of two counts. Their range has zero in its middle: by default the
/// 99th percentile of the distances from zero.
Result<HeatStatistics> heat_statistics(std::span<const std::int32_t> differences,
                                       const HeatOptions& options);
/// Bars of a histogram.
inline constexpr std::size_t heat_bars = 64;
/// The number of values in each of the equal parts of [min, max], which heat_statistics() gave.
template <class Value>
[[nodiscard]] std::vector<std::uint64_t> heat_histogram(std::span<const Value> values,
                                                        const HeatStatistics& statistics);
/// The width that the legend needs; a narrower map is widened on the right.
inline constexpr std::uint32_t heat_picture_width_min = 288;
/// Rows of the legend at most.
inline constexpr std::uint32_t heat_legend_height_max = 256;
/// The map with a legend strip added below, so that the picture is higher than `height`: palette,
/// ticks, unit, min/mean/p50/p99/max and the clipped share. `statistics` as heat_statistics gave
/// it.
Result<Picture> heat_picture(std::uint32_t width, std::uint32_t height,
                             std::span<const std::uint32_t> counts,
                             const HeatStatistics& statistics, const HeatOptions& options);
/// The same of differences, whose colours and ticks have zero in their middle.
Result<Picture> heat_picture(std::uint32_t width, std::uint32_t height,
                             std::span<const std::int32_t> differences,
                             const HeatStatistics& statistics, const HeatOptions& options);

}  // namespace raynest
