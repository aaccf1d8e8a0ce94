#include "engine/scene/opacity.h"

#include "engine/geometry/hit.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace raynest {
namespace {

/// Error bound of texture coordinates computed in float, relative to the largest term: a few
/// roundings of 2^-24, and barycentric coordinates that leave the triangle by as much.
constexpr double coordinate_error = 0x1p-18;
/// The same for alpha in 255ths, relative and absolute.
constexpr double alpha_error_relative = 0x1p-16;
constexpr double alpha_error = 0x1p-12;

/// Limits on the work per footprint. Beyond them its range is widened, which is slower but correct.
constexpr double tiles_max = 4;  ///< periods of the texture along one axis
constexpr int cells_max = 512;   ///< visited pyramid cells, about 10 us

/// One axis of the image, and the triangle's extent along it.
struct Axis {
    double size;  ///< texels
    Wrap wrap;
    double reach;         ///< distance at which the filter still touches texels, with errors
    double lower, upper;  ///< extent of the triangle in texels, before wrapping

    [[nodiscard]] double first_tile() const {
        return wrap == Wrap::clamp ? 0 : std::floor((lower - reach) / size);
    }
    [[nodiscard]] double last_tile() const {
        return wrap == Wrap::clamp ? 0 : std::floor((upper + reach) / size);
    }
    /// Returns the position of a point when its tile is mapped to the image.
    [[nodiscard]] double laid(double x, double tile) const {
        const double within = x - tile * size;
        const bool mirrored = wrap == Wrap::mirror && std::fmod(tile, 2) != 0;
        return mirrored ? size - within : within;
    }
};

struct TexelPoint {
    double x, y;
};

struct Rectangle {
    TexelPoint lower, upper;
};

/// Tests separating axes: the rectangle's sides, then those of the triangle that have a length.
bool overlaps(const std::array<TexelPoint, 3>& triangle, const Rectangle& r) {
    const auto [x0, x1] = std::minmax({triangle[0].x, triangle[1].x, triangle[2].x});
    const auto [y0, y1] = std::minmax({triangle[0].y, triangle[1].y, triangle[2].y});
    if (x1 < r.lower.x || x0 > r.upper.x || y1 < r.lower.y || y0 > r.upper.y) return false;
    for (std::size_t k = 0; k < 3; ++k) {
        const TexelPoint& a = triangle[k];
        const TexelPoint& b = triangle[(k + 1) % 3];
        const TexelPoint& c = triangle[(k + 2) % 3];
        double nx = b.y - a.y, ny = a.x - b.x;
        if (nx * (c.x - a.x) + ny * (c.y - a.y) > 0) {  // outward: away from c
            nx = -nx;
            ny = -ny;
        }
        const double nearest_x = nx > 0 ? r.lower.x : r.upper.x;
        const double nearest_y = ny > 0 ? r.lower.y : r.upper.y;
        if (nx * (nearest_x - a.x) + ny * (nearest_y - a.y) > 0) return false;
    }
    return true;
}

/// Descends a pyramid to the texels that a triangle's footprint touches. Skips cells that cannot
/// widen the range.
class Footprint {
public:
    Footprint(const AlphaPyramid& pyramid, const Axis& x, const Axis& y)
        : pyramid_(pyramid),
          x_(x),
          y_(y) {}

    AlphaPyramid::Range range_of(const std::array<TexelPoint, 3>& triangle) {
        const bool bounded = std::isfinite(x_.upper - x_.lower) &&
                             std::isfinite(y_.upper - y_.lower) &&
                             x_.last_tile() - x_.first_tile() < tiles_max &&
                             y_.last_tile() - y_.first_tile() < tiles_max;
        if (!bounded) return pyramid_.at(pyramid_.top(), 0, 0);
        for (double ty = y_.first_tile(); ty <= y_.last_tile(); ++ty) {
            for (double tx = x_.first_tile(); tx <= x_.last_tile(); ++tx) {
                for (std::size_t k = 0; k < 3; ++k) {
                    laid_[k] = {x_.laid(triangle[k].x, tx), y_.laid(triangle[k].y, ty)};
                }
                walk(pyramid_.top(), 0, 0);
            }
        }
        return range_;
    }

private:
    void walk(std::uint32_t level, std::uint32_t x, std::uint32_t y) {
        const AlphaPyramid::Range cell = pyramid_.at(level, x, y);
        if (cell.least >= range_.least && cell.largest <= range_.largest) return;
        if (!overlaps(laid_, touching(level, x, y))) return;
        if (level == 0 || ++cells_ > cells_max) {
            range_.least = std::min(range_.least, cell.least);
            range_.largest = std::max(range_.largest, cell.largest);
            return;
        }
        const std::uint32_t below = level - 1;
        for (std::uint32_t cy = 2 * y; cy < 2 * y + 2; ++cy) {
            for (std::uint32_t cx = 2 * x; cx < 2 * x + 2; ++cx) {
                if (cx << below < pyramid_.width() && cy << below < pyramid_.height()) {
                    walk(below, cx, cy);
                }
            }
        }
    }

    /// Returns the rectangle of points from which the filter touches the cell's texels.
    [[nodiscard]] Rectangle touching(std::uint32_t level, std::uint32_t x, std::uint32_t y) const {
        const auto [x0, x1] =
            touching(x_, std::uint64_t{x} << level, std::uint64_t{x + 1} << level);
        const auto [y0, y1] =
            touching(y_, std::uint64_t{y} << level, std::uint64_t{y + 1} << level);
        return {{x0, y0}, {x1, y1}};
    }
    static std::pair<double, double> touching(const Axis& axis, std::uint64_t first,
                                              std::uint64_t end) {
        double lower = static_cast<double>(first) - axis.reach;
        double upper = static_cast<double>(end) + axis.reach;
        if (axis.wrap == Wrap::clamp) {  // the border's texels extend to infinity
            if (first == 0) lower = std::min(lower, axis.lower - 1);
            if (static_cast<double>(end) >= axis.size) upper = std::max(upper, axis.upper + 1);
        }
        return {lower, upper};
    }

    const AlphaPyramid& pyramid_;
    const Axis& x_;
    const Axis& y_;
    std::array<TexelPoint, 3> laid_{};
    AlphaPyramid::Range range_{255, 0};
    int cells_ = 0;
};

/// Returns the range of the texture's alpha over a triangle.
AlphaPyramid::Range texture_range(const AlphaPyramid& pyramid, const TextureDescription& texture,
                                  const MaterialDescription& material,
                                  const std::array<Vec2, 3>& corners) {
    Axis axes[2] = {{static_cast<double>(pyramid.width()), texture.wrap_s, 0, 0, 0},
                    {static_cast<double>(pyramid.height()), texture.wrap_t, 0, 0, 0}};
    std::array<TexelPoint, 3> triangle{};
    for (std::size_t i = 0; i < 2; ++i) {
        Axis& axis = axes[i];
        std::array<double, 3> at{};
        double largest_term = 1;
        for (std::size_t k = 0; k < 3; ++k) {
            const double terms[3] = {
                double{material.uv_transform[3 * i]} * double{corners[k].x},
                double{material.uv_transform[3 * i + 1]} * double{corners[k].y},
                double{material.uv_transform[3 * i + 2]}};
            at[k] = (terms[0] + terms[1] + terms[2]) * axis.size;
            for (const double term : terms) largest_term = std::max(largest_term, std::abs(term));
            (i == 0 ? triangle[k].x : triangle[k].y) = at[k];
        }
        axis.lower = std::min({at[0], at[1], at[2]});
        axis.upper = std::max({at[0], at[1], at[2]});
        // Test the sum: max() may ignore NaN.
        if (!std::isfinite(at[0] + at[1] + at[2])) axis.upper = HUGE_VAL;
        axis.reach = (texture.nearest ? 0 : 0.5) + coordinate_error * largest_term * axis.size;
    }
    return Footprint(pyramid, axes[0], axes[1]).range_of(triangle);
}

}  // namespace

AlphaPyramid::AlphaPyramid(const ImageDescription& image) : image_(image) {
    std::uint32_t width = image.width, height = image.height;
    while (width > 1 || height > 1) {
        const std::uint32_t below = top();
        Level level{(width + 1) / 2, (height + 1) / 2, {}};
        level.cells.resize(std::size_t{level.width} * level.height, {255, 0});
        for (std::uint32_t y = 0; y < height; ++y) {
            for (std::uint32_t x = 0; x < width; ++x) {
                const Range from = at(below, x, y);
                Range& to = level.cells[std::size_t{y / 2} * level.width + x / 2];
                to = {std::min(to.least, from.least), std::max(to.largest, from.largest)};
            }
        }
        width = level.width;
        height = level.height;
        levels_.push_back(std::move(level));
    }
}

std::vector<std::uint8_t> OpacityBuilder::build(const GeometryDescription& geometry) {
    if (geometry.material == no_id) return {};
    const MaterialDescription& material = scene_.materials[geometry.material];
    if (material.alpha_mode == AlphaMode::opaque) return {};
    const TextureDescription* texture = nullptr;
    const AlphaPyramid* pyramid = nullptr;
    if (material.texture != no_id && !geometry.texcoords[material.texcoord].empty()) {
        texture = &scene_.textures[material.texture];
        pyramid =
            &pyramids_.try_emplace(texture->image, scene_.images[texture->image]).first->second;
    }
    const auto factor = static_cast<double>(material.base_colour.w);

    const std::size_t triangles = geometry.indices.size() / 3;
    std::vector<std::uint8_t> ranges(2 * triangles);
    tbb::parallel_for(std::size_t{0}, triangles, [&](std::size_t t) {
        const std::uint32_t* const corner = geometry.indices.data() + 3 * t;
        double least = factor * 255, largest = factor * 255;
        if (pyramid != nullptr) {
            const auto range = texture_range(*pyramid, *texture, material,
                                             geometry.corner_texcoords(material.texcoord, t));
            least *= range.least / 255.0;
            largest *= range.largest / 255.0;
        }
        if (!geometry.colours.empty()) {
            const auto colour = [&](std::size_t k) {
                return geometry.colours[4 * std::size_t{corner[k]} + 3] / 255.0;
            };
            least *= std::min({colour(0), colour(1), colour(2)});
            largest *= std::max({colour(0), colour(1), colour(2)});
        }
        // Round outward. 0 gives no lower bound. Zeros alone are filtered to exactly 0.
        const double lower = std::floor(least * (1 - alpha_error_relative) - alpha_error);
        const double upper =
            largest == 0 ? 0 : std::ceil(largest * (1 + alpha_error_relative) + alpha_error);
        const bool known = factor >= 0;
        ranges[2 * t] = known ? static_cast<std::uint8_t>(std::clamp(lower, 0.0, 255.0)) : 0;
        ranges[2 * t + 1] = known ? static_cast<std::uint8_t>(std::clamp(upper, 0.0, 255.0)) : 255;
    });
    // Drop a table without bounds: it would cost each candidate a cache miss for nothing.
    const auto open = [&](std::size_t t) { return ranges[2 * t] == 0 && ranges[2 * t + 1] == 255; };
    for (std::size_t t = 0; t < triangles; ++t) {
        if (!open(t)) return ranges;
    }
    return {};
}

}  // namespace raynest
