#include "engine/shading/environment.h"

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

/// Turns less the whole ones: 0 to 1.
float turn_part(float turns) {
    return turns - std::floor(turns);
}

}  // namespace

void Environment::Guide::add(const float* sums, std::size_t count, std::size_t stride) {
    const float total = sums[(count - 1) * stride];
    std::size_t i = 0;
    for (std::size_t share = 0; share < count; ++share) {
        const float at = static_cast<float>(share) / static_cast<float>(count) * total;
        while (i + 1 < count && sums[i * stride] <= at) ++i;
        first_.push_back(static_cast<std::uint16_t>(i));
    }
}

std::size_t Environment::Guide::find(const float* sums, std::size_t count, std::size_t stride,
                                     std::size_t list, float u, float& rest) const {
    const float value = u * sums[(count - 1) * stride];
    std::size_t i = first(count, list, u);
    // Rounding may have begun one share too late.
    while (i > 0 && sums[(i - 1) * stride] > value) --i;
    while (i + 1 < count && sums[i * stride] <= value) ++i;
    // Skip entries without weight at the end.
    while (i > 0 && !(sums[i * stride] > sums[(i - 1) * stride])) --i;
    const float before = i == 0 ? 0.0F : sums[(i - 1) * stride];
    const float weight = sums[i * stride] - before;
    rest = weight > 0 ? std::clamp((value - before) / weight, 0.0F, one_below) : 0.5F;
    return i;
}

Environment::Environment(std::uint32_t width, std::uint32_t height, std::span<const Vec3> pixels,
                         float middle)
    : width_(width),
      height_(height),
      middle_(middle) {
    texels_.reserve(pixels.size());
    for (const Vec3& pixel : pixels) {
        Vec4& p = texels_.emplace_back(pixel, 0);
        for (int c = 0; c < 3; ++c)
            if (!(p[c] > 0) || !std::isfinite(p[c])) p[c] = 0;
    }
    rows_.resize(height);
    double sum = 0;
    for (std::uint32_t y = 0; y < height; ++y) {
        // The solid angle of a pixel, and the mean over all that interpolation mixes into it.
        const double sine = std::cos(std::numbers::pi * (0.5 - (y + 0.5) / height));
        double row = 0;
        for (std::uint32_t x = 0; x < width; ++x) {
            double weight = 0;
            for (int dy = -1; dy <= 1; ++dy) {
                for (int dx = -1; dx <= 1; ++dx) {
                    const Vec3 p(texel(static_cast<int>(x) + dx, static_cast<int>(y) + dy));
                    weight += (dx == 0 ? 0.75 : 0.125) * (dy == 0 ? 0.75 : 0.125) *
                              static_cast<double>(brightness(p));
                }
            }
            row += weight * sine;
            texels_[std::size_t{y} * width + x].w = static_cast<float>(row);
        }
        sum += row;
        rows_[y] = static_cast<float>(sum);
    }
    row_guide_.add(rows_.data(), height, 1);
    row_densities_.resize(height);
    for (std::size_t y = 0; y < height; ++y) {
        column_guide_.add(&texels_[y * width].w, width, 4);
        const float in_row = rows_[y] - (y == 0 ? 0.0F : rows_[y - 1]);
        const float in_columns = texels_[(y + 1) * width - 1].w;
        if (in_columns > 0 && rows_.back() > 0)
            row_densities_[y] = in_row / rows_.back() / in_columns * static_cast<float>(width) *
                                static_cast<float>(height) / (2.0F * pi * pi);
    }
}

const Vec4& Environment::texel(int column, int row) const {
    const int w = static_cast<int>(width_);
    const int x = column < 0 ? column + w : column >= w ? column - w : column;
    const int y = std::clamp(row, 0, static_cast<int>(height_) - 1);
    return texels_[static_cast<std::size_t>(y) * width_ + static_cast<std::size_t>(x)];
}

Vec3 Environment::radiance_at(const Vec2& at) const {
    const float left = std::floor(at.x - 0.5F);
    const float top = std::floor(at.y - 0.5F);
    const float across = at.x - 0.5F - left;
    const float down = at.y - 0.5F - top;
    const int x = static_cast<int>(left);
    const int y = static_cast<int>(top);
    const Vec4 upper = texel(x, y) * (1 - across) + texel(x + 1, y) * across;
    const Vec4 lower = texel(x, y + 1) * (1 - across) + texel(x + 1, y + 1) * across;
    return Vec3(upper * (1 - down) + lower * down);
}

float Environment::density_at(std::size_t column, std::size_t row, float sine) const {
    const Vec4* texels = texels_.data() + row * width_;
    const float weight = texels[column].w - (column == 0 ? 0.0F : texels[column - 1].w);
    return row_densities_[row] * weight / std::max(sine, 1e-6F);
}

Environment::View Environment::view(const Vec3& direction) const {
    if (empty()) return {};
    const Vec3 d = to_y_up(up_, direction);
    const float u = turn_part(0.5F + arc_tangent(d.x, -d.z) * (0.5F / pi) - middle_);
    const float v = arc_cosine(d.y) * (1.0F / pi);
    const Vec2 at(std::min(u, one_below) * static_cast<float>(width_),
                  std::clamp(v, 0.0F, one_below) * static_cast<float>(height_));
    const float sine = std::sqrt(std::max(1.0F - d.y * d.y, 0.0F));
    return {radiance_at(at),
            density_at(static_cast<std::size_t>(at.x), static_cast<std::size_t>(at.y), sine)};
}

Vec3 Environment::sample(const Vec2& u, View& view) const {
    view = {};
    if (empty() || !(rows_.back() > 0)) return Vec3(0, 1, 0);
    float down = 0, across = 0;
    const std::size_t y = row_guide_.find(rows_.data(), height_, 1, 0, u.y, down);
    if (!(row_densities_[y] > 0)) return Vec3(0, 1, 0);
    const std::size_t x = column_guide_.find(&texels_[y * width_].w, width_, 4, y, u.x, across);
    const Vec2 at(static_cast<float>(x) + across, static_cast<float>(y) + down);
    // Half a turn behind the picture's middle lies its left edge.
    const Vec2 azimuth = circle(turn_part(at.x / static_cast<float>(width_) + middle_));
    const Vec2 polar = circle(0.5F * std::min(at.y / static_cast<float>(height_), 1.0F));
    view = {radiance_at(at), density_at(x, y, polar.y)};
    return from_y_up(up_, Vec3(-polar.y * azimuth.y, polar.x, polar.y * azimuth.x));
}

void Environment::fetch_guide(const Vec2& u) const {
    if (empty()) return;
    float down = 0;
    const std::size_t y = row_guide_.find(rows_.data(), height_, 1, 0, u.y, down);
    __builtin_prefetch(&column_guide_.first(width_, y, u.x));
    __builtin_prefetch(&texels_[(y + 1) * width_ - 1]);
}

void Environment::fetch_texels(const Vec2& u) const {
    if (empty()) return;
    float down = 0;
    const std::size_t y = row_guide_.find(rows_.data(), height_, 1, 0, u.y, down);
    const std::size_t x = column_guide_.first(width_, y, u.x);
    const std::size_t other =
        down < 0.5F ? std::max<std::size_t>(y, 1) - 1 : std::min<std::size_t>(y + 1, height_ - 1);
    __builtin_prefetch(&texels_[y * width_ + x]);
    __builtin_prefetch(&texels_[other * width_ + x]);
}

Vec3 Environment::irradiance_up() const {
    glm::dvec3 sum(0);
    for (std::uint32_t y = 0; y < height_ / 2; ++y) {
        const double polar = std::numbers::pi * (y + 0.5) / height_;
        for (std::uint32_t x = 0; x < width_; ++x)
            sum += glm::dvec3(texels_[std::size_t{y} * width_ + x]) *
                   (std::sin(polar) * std::cos(polar));
    }
    return Vec3(sum * (2 * std::numbers::pi * std::numbers::pi / width_ / height_));
}

}  // namespace raynest
