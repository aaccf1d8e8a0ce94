// A film: means of samples, pixel by pixel, and what the first ray of each pixel met.
//
// Means are kept as float32 and updated sample by sample, in the order of their numbers:
//
//     mean += (sample - mean) / count
//
// So the state of a film is exactly what its EXR holds, and a film that is read back goes on as if
// it had never stopped. At 65,536 samples the rounding of the updates adds up to about 1e-5.
#pragma once

#include "engine/geometry/hit.h"
#include "engine/integrators/generators.h"
#include "engine/math/vec.h"

#include <cstdint>
#include <cstdlib>
#include <functional>
#include <memory>
#include <span>
#include <string_view>

namespace raynest {

/// One sample of a pixel, as an integrator makes it.
struct FilmSample {
    Vec3 radiance{0};  ///< linear Rec. 709, premultiplied by alpha
    float alpha = 0;   ///< 1 where the camera ray met a surface, or what counts as one
    Vec3 albedo{0};    ///< the first surface's, in [0, 1]; 0 for a miss
    Vec3 normal{0};    ///< the first surface's, turned to the ray, unit length; 0 for a miss
    /// The first surface; a film keeps that of sample 0 alone, because ids and depths have no mean.
    float depth = 0;                 ///< `t` of the camera ray, along the view axis
    Vec3 position{0};                ///< relative to the scene's origin
    std::uint32_t instance = no_id;  ///< path id, or its low 32 bits
    std::uint32_t mesh = no_id;      ///< object of the scene
    std::uint32_t material = no_id;
};

/// Channels of 32 bits, in the order of planes.
enum class FilmLayer : std::uint8_t {
#define RAYNEST_LAYER(id, name, type, text) id,
#include "engine/integrators/layers.def"
    count_
};
inline constexpr std::size_t film_layers = static_cast<std::size_t>(FilmLayer::count_);

struct FilmLayerInfo {
    std::string_view name;  ///< name of the channel in an EXR
    bool is_float;
    std::string_view text;
};
[[nodiscard]] std::span<const FilmLayerInfo, film_layers> film_layer_table();

/// Depth of a miss, as Blender writes it.
inline constexpr float film_depth_miss = 1e10F;

/// All layers of a picture, row 0 on top. Threads may add samples to different pixels at once.
class Film {
public:
    /// Fills the film, which takes 0.1 s for 16 million pixels, until `wanted` returns false; a
    /// film that is not wanted is not whole. Throws std::bad_alloc.
    explicit Film(
        ImageSize size, const std::function<bool()>& wanted = [] { return true; });

    [[nodiscard]] ImageSize size() const { return size_; }
    [[nodiscard]] static std::uint64_t bytes(ImageSize size) {
        return size.pixels() * film_layers * sizeof(float);
    }

    /// Adds samples of a pixel, given by its index row by row, in the order of their numbers. The
    /// first of them has number `first`. Samples that are not finite are counted and dropped.
    void add(std::uint64_t pixel, std::uint32_t first, std::span<const FilmSample> samples);

    [[nodiscard]] std::span<float> floats(FilmLayer layer) {
        return {reinterpret_cast<float*>(plane(layer)), size_.pixels()};
    }
    [[nodiscard]] std::span<const float> floats(FilmLayer layer) const {
        return {reinterpret_cast<const float*>(plane(layer)), size_.pixels()};
    }
    [[nodiscard]] std::span<std::uint32_t> words(FilmLayer layer) {
        return {plane(layer), size_.pixels()};
    }
    [[nodiscard]] std::span<const std::uint32_t> words(FilmLayer layer) const {
        return {plane(layer), size_.pixels()};
    }
    /// Mean RGBA, premultiplied.
    [[nodiscard]] Vec4 colour(std::uint64_t pixel) const;
    /// Samples that a pixel got, dropped ones included: the number of the next one.
    [[nodiscard]] std::uint32_t taken(std::uint64_t pixel) const {
        return words(FilmLayer::samples)[pixel] + words(FilmLayer::dropped)[pixel];
    }
    /// Estimated standard error of a pixel's mean luminance; 0 with less than two samples.
    [[nodiscard]] float error(std::uint64_t pixel) const;
    /// Samples that were dropped, of all pixels.
    [[nodiscard]] std::uint64_t dropped() const;

private:
    [[nodiscard]] std::uint32_t* plane(FilmLayer layer) const {
        return words_.get() + static_cast<std::size_t>(layer) * size_.pixels();
    }
    ImageSize size_;
    struct Free {
        void operator()(std::uint32_t* words) const { std::free(words); }
    };
    std::unique_ptr<std::uint32_t[], Free> words_;
};

/// Y of linear Rec. 709.
[[nodiscard]] inline float luminance(const Vec3& colour) {
    return 0.2126F * colour.x + 0.7152F * colour.y + 0.0722F * colour.z;
}

}  // namespace raynest
