#include "engine/integrators/film.h"

#include "engine/math/finite.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>

namespace raynest {
namespace {

bool all_finite(const FilmSample& sample) {
    return is_finite(sample.radiance) && std::isfinite(sample.alpha) && is_finite(sample.albedo) &&
           is_finite(sample.normal) && std::isfinite(luminance(sample.radiance));
}

constexpr std::array<FilmLayerInfo, film_layers> layers = {{
#define f32 true
#define u32 false
#define RAYNEST_LAYER(id, name, type, text) {#name, type, text},
#include "engine/integrators/layers.def"
#undef f32
#undef u32
}};

}  // namespace

std::span<const FilmLayerInfo, film_layers> film_layer_table() {
    return layers;
}

Film::Film(ImageSize size, const std::function<bool()>& wanted)
    : size_(size),
      // The system makes a page of zeros when a thread first adds a sample there: many do so at
      // once.
      words_(static_cast<std::uint32_t*>(
          std::calloc(film_layers * size.pixels(), sizeof(std::uint32_t)))) {
    if (words_ == nullptr) throw std::bad_alloc();
    constexpr std::uint64_t step = 1 << 20;
    for (std::uint64_t first = 0; first < size.pixels() && wanted(); first += step) {
        const std::uint64_t count = std::min(step, size.pixels() - first);
        std::ranges::fill(floats(FilmLayer::z).subspan(first, count), film_depth_miss);
        for (const FilmLayer ids : {FilmLayer::instance, FilmLayer::mesh, FilmLayer::material})
            std::ranges::fill(words(ids).subspan(first, count), no_id);
    }
}

void Film::add(std::uint64_t pixel, std::uint32_t first, std::span<const FilmSample> samples) {
    const auto at = [&](FilmLayer layer) -> float& { return floats(layer)[pixel]; };
    if (first == 0 && !samples.empty()) {
        const FilmSample& sample = samples.front();
        // A sample that is dropped may have no place either.
        const bool hit =
            sample.mesh != no_id && std::isfinite(sample.depth) && is_finite(sample.position);
        at(FilmLayer::z) = hit ? sample.depth : film_depth_miss;
        at(FilmLayer::p_x) = hit ? sample.position.x : 0;
        at(FilmLayer::p_y) = hit ? sample.position.y : 0;
        at(FilmLayer::p_z) = hit ? sample.position.z : 0;
        words(FilmLayer::instance)[pixel] = sample.instance;
        words(FilmLayer::mesh)[pixel] = sample.mesh;
        words(FilmLayer::material)[pixel] = sample.material;
    }
    // In registers while the samples come: planes lie far apart.
    constexpr std::array means = {FilmLayer::r,        FilmLayer::g,        FilmLayer::b,
                                  FilmLayer::a,        FilmLayer::albedo_r, FilmLayer::albedo_g,
                                  FilmLayer::albedo_b, FilmLayer::n_x,      FilmLayer::n_y,
                                  FilmLayer::n_z,      FilmLayer::variance};
    constexpr std::size_t variance = means.size() - 1;
    std::array<float, means.size()> mean;
    for (std::size_t i = 0; i < means.size(); ++i) mean[i] = at(means[i]);
    std::uint32_t taken = words(FilmLayer::samples)[pixel];
    const auto mean_luminance = [&] { return luminance({mean[0], mean[1], mean[2]}); };
    for (const FilmSample& sample : samples) {
        if (!all_finite(sample)) {
            ++words(FilmLayer::dropped)[pixel];
            continue;
        }
        const auto count = static_cast<float>(++taken);
        const float value = luminance(sample.radiance);
        const float before = value - mean_luminance();
        const std::array<float, variance> values = {
            sample.radiance.x, sample.radiance.y, sample.radiance.z, sample.alpha,
            sample.albedo.x,   sample.albedo.y,   sample.albedo.z,   sample.normal.x,
            sample.normal.y,   sample.normal.z};
        for (std::size_t i = 0; i < variance; ++i) mean[i] += (values[i] - mean[i]) / count;
        // Welford, with the variance itself as state: the file holds nothing else.
        const float after = value - mean_luminance();
        // The square of a finite value may overflow.
        const float square = std::clamp(before * after, 0.0F, std::numeric_limits<float>::max());
        mean[variance] += (square - mean[variance]) / count;
    }
    for (std::size_t i = 0; i < means.size(); ++i) at(means[i]) = mean[i];
    words(FilmLayer::samples)[pixel] = taken;
}

Vec4 Film::colour(std::uint64_t pixel) const {
    return {floats(FilmLayer::r)[pixel], floats(FilmLayer::g)[pixel], floats(FilmLayer::b)[pixel],
            floats(FilmLayer::a)[pixel]};
}

float Film::error(std::uint64_t pixel) const {
    const std::uint32_t count = words(FilmLayer::samples)[pixel];
    if (count < 2) return 0;
    return std::sqrt(floats(FilmLayer::variance)[pixel] / static_cast<float>(count - 1));
}

std::uint64_t Film::dropped() const {
    std::uint64_t sum = 0;
    for (const std::uint32_t count : words(FilmLayer::dropped)) sum += count;
    return sum;
}

}  // namespace raynest
