// A painter for procedural textures: tapered shapes with anti-aliased straight alpha.
#pragma once

#include "engine/scene/description.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace raynest {

/// An image in sRGB, colours in [0, 1], pixel coordinates with y down. It starts transparent, but
/// with a fill colour: bilinear lookups at an edge see no dark fringe, and a picture whose mask is
/// ignored still shows a fitting colour.
class Canvas {
public:
    Canvas(std::uint32_t width, std::uint32_t height, const Vec3& fill, float alpha = 0)
        : width_(width),
          height_(height),
          pixels_(std::size_t{width} * height, Vec4(fill, alpha)) {}

    [[nodiscard]] std::uint32_t width() const { return width_; }
    [[nodiscard]] std::uint32_t height() const { return height_; }
    Vec4& at(std::uint32_t x, std::uint32_t y) { return pixels_[std::size_t{y} * width_ + x]; }

    /// Paints a shape along the axis from `base` to `tip` over the picture: `half_width(s)` in
    /// pixels for s in [0, 1] along it, `colour(s, t)` with t in [-1, 1] across it. Wraps round the
    /// edges when `tiled`.
    template <class HalfWidth, class Colour>
    void shape(const Vec2& base, const Vec2& tip, float widest, HalfWidth half_width, Colour colour,
               bool tiled = false) {
        const Vec2 axis = tip - base;
        const float length = glm::length(axis);
        if (!(length > 0)) return;
        const Vec2 along = axis / length;
        const Vec2 across(-along.y, along.x);
        const Vec2 low = glm::min(base, tip) - Vec2(widest + 1);
        const Vec2 high = glm::max(base, tip) + Vec2(widest + 1);
        for (int y = static_cast<int>(std::floor(low.y)); y <= static_cast<int>(high.y); ++y) {
            for (int x = static_cast<int>(std::floor(low.x)); x <= static_cast<int>(high.x); ++x) {
                const Vec2 p(static_cast<float>(x) + 0.5F - base.x,
                             static_cast<float>(y) + 0.5F - base.y);
                const float s = glm::dot(p, along) / length;
                const float t = glm::dot(p, across);
                const float half = half_width(std::clamp(s, 0.0F, 1.0F));
                // Coverage of the pixel by the side edge and by the two ends.
                const float side = std::clamp(half - std::abs(t) + 0.5F, 0.0F, 1.0F);
                const float ends = std::clamp(std::min(s, 1 - s) * length + 0.5F, 0.0F, 1.0F);
                const float coverage = side * ends * std::min(1.0F, half * 2);
                if (coverage <= 0) continue;
                Vec4* pixel = find(x, y, tiled);
                if (pixel == nullptr) continue;
                blend(*pixel, colour(s, half > 0 ? std::clamp(t / half, -1.0F, 1.0F) : 0.0F),
                      coverage);
            }
        }
    }

    [[nodiscard]] ImageDescription image() const {
        ImageDescription out{width_, height_, {}};
        out.rgba.reserve(pixels_.size() * 4);
        for (const Vec4& pixel : pixels_) {
            for (int c = 0; c < 4; ++c) {
                out.rgba.push_back(
                    static_cast<std::uint8_t>(std::lround(std::clamp(pixel[c], 0.0F, 1.0F) * 255)));
            }
        }
        return out;
    }

private:
    Vec4* find(int x, int y, bool tiled) {
        const int w = static_cast<int>(width_);
        const int h = static_cast<int>(height_);
        if (tiled) {
            x = ((x % w) + w) % w;
            y = ((y % h) + h) % h;
        }
        if (x < 0 || y < 0 || x >= w || y >= h) return nullptr;
        return &at(static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y));
    }

    static void blend(Vec4& pixel, const Vec3& colour, float coverage) {
        const float alpha = coverage + pixel.a * (1 - coverage);
        const Vec3 mixed = (coverage * colour + pixel.a * (1 - coverage) * Vec3(pixel)) / alpha;
        pixel = Vec4(mixed, alpha);
    }

    std::uint32_t width_;
    std::uint32_t height_;
    std::vector<Vec4> pixels_;
};

}  // namespace raynest
