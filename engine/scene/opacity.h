// Opacity: the least and the largest alpha anywhere on a triangle. With it most candidates on a
// masked surface are decided without reading the texture.
//
// It is computed at build time for triangles of MASK and BLEND materials: the range of all texels
// that the filter can touch while a point moves over the triangle, through the wrap modes and the
// texture transform, times the factor, times the range of the vertex colours. It has two bytes per
// triangle, rounded outward; requests compare them with their cutoff (intersectors/alpha_mask.h).
#pragma once

#include "engine/scene/description.h"

#include <cstdint>
#include <map>
#include <vector>

namespace raynest {

/// The least and largest alpha of the texels in squares of 1, 2, 4, ... texels. A third of the
/// image's alpha plane, twice; built in one pass, about 1 ns per texel.
class AlphaPyramid {
public:
    struct Range {
        std::uint8_t least, largest;
    };

    explicit AlphaPyramid(const ImageDescription& image);

    [[nodiscard]] std::uint32_t top() const { return static_cast<std::uint32_t>(levels_.size()); }
    /// Returns the range of texels [x << level, (x + 1) << level), likewise y, in the image.
    [[nodiscard]] Range at(std::uint32_t level, std::uint32_t x, std::uint32_t y) const {
        if (level == 0) {
            const std::uint8_t a = image_.rgba[4 * (std::size_t{y} * image_.width + x) + 3];
            return {a, a};
        }
        const Level& row = levels_[level - 1];
        return row.cells[std::size_t{y} * row.width + x];
    }
    [[nodiscard]] std::uint32_t width() const { return image_.width; }
    [[nodiscard]] std::uint32_t height() const { return image_.height; }

private:
    struct Level {
        std::uint32_t width, height;
        std::vector<Range> cells;
    };
    const ImageDescription& image_;
    std::vector<Level> levels_;  ///< from squares of 2 x 2 texels to one cell
};

class OpacityBuilder {
public:
    explicit OpacityBuilder(const SceneDescription& scene) : scene_(scene) {}

    /// Returns {least, largest} alpha of each triangle in 255ths; 0 and 255 mean "no bound", since
    /// alpha may lie beyond them. Empty for opaque materials, and if no triangle has a bound.
    /// Measured: 0.3 to 1.5 us per triangle; at most a few hundred steps, whatever its size in
    /// texels.
    std::vector<std::uint8_t> build(const GeometryDescription& geometry);

private:
    const SceneDescription& scene_;
    std::map<std::uint32_t, AlphaPyramid> pyramids_;  ///< for the images in use
};

}  // namespace raynest
