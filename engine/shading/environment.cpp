#include "engine/shading/environment.h"

#include <algorithm>
#include <cmath>

namespace raynest {
namespace {

/// Returns the entry of ascending sums in which u * total falls, and the rest in [0, 1).
std::size_t find_interval(std::span<const float> sums, float u, float& rest) {
    const float at = u * sums.back();
    const auto next = std::upper_bound(sums.begin(), sums.end(), at);
    std::size_t i = std::min(static_cast<std::size_t>(next - sums.begin()), sums.size() - 1);
    // Skip entries without weight at the end.
    while (i > 0 && !(sums[i] > sums[i - 1])) --i;
    const float before = i == 0 ? 0.0F : sums[i - 1];
    const float weight = sums[i] - before;
    rest = weight > 0 ? std::clamp((at - before) / weight, 0.0F, one_below) : 0.5F;
    return i;
}

}  // namespace

Environment::Environment(std::uint32_t width, std::uint32_t height, std::span<const Vec3> pixels)
    : width_(width),
      height_(height),
      pixels_(pixels.begin(), pixels.end()) {
    for (Vec3& p : pixels_)
        for (int c = 0; c < 3; ++c)
            if (!(p[c] > 0) || !std::isfinite(p[c])) p[c] = 0;
    rows_.resize(height);
    columns_.resize(std::size_t{width} * height);
    double sum = 0;
    for (std::uint32_t y = 0; y < height; ++y) {
        // The solid angle of a pixel, and the mean over all that interpolation mixes into it.
        const double sine = std::cos(std::numbers::pi * (0.5 - (y + 0.5) / height));
        double row = 0;
        for (std::uint32_t x = 0; x < width; ++x) {
            double weight = 0;
            for (int dy = -1; dy <= 1; ++dy) {
                for (int dx = -1; dx <= 1; ++dx) {
                    const Vec3& p = pixel(static_cast<int>(x) + dx, static_cast<int>(y) + dy);
                    weight += (dx == 0 ? 0.75 : 0.125) * (dy == 0 ? 0.75 : 0.125) *
                              static_cast<double>(brightness(p));
                }
            }
            row += weight * sine;
            columns_[std::size_t{y} * width + x] = static_cast<float>(row);
        }
        sum += row;
        rows_[y] = static_cast<float>(sum);
    }
}

const Vec3& Environment::pixel(int column, int row) const {
    const int w = static_cast<int>(width_);
    const int x = column < 0 ? column + w : column >= w ? column - w : column;
    const int y = std::clamp(row, 0, static_cast<int>(height_) - 1);
    return pixels_[static_cast<std::size_t>(y) * width_ + static_cast<std::size_t>(x)];
}

Vec2 Environment::place_of(const Vec3& d) const {
    const float u = 0.5F + std::atan2(d.x, -d.z) / (2.0F * pi);
    const float v = std::acos(std::clamp(d.y, -1.0F, 1.0F)) / pi;
    return {std::clamp(u, 0.0F, one_below) * static_cast<float>(width_),
            std::clamp(v, 0.0F, one_below) * static_cast<float>(height_)};
}

Vec3 Environment::radiance(const Vec3& direction) const {
    if (empty()) return Vec3(0);
    const Vec2 at = place_of(direction);
    const float left = std::floor(at.x - 0.5F);
    const float top = std::floor(at.y - 0.5F);
    const float across = at.x - 0.5F - left;
    const float down = at.y - 0.5F - top;
    const int x = static_cast<int>(left);
    const int y = static_cast<int>(top);
    return (pixel(x, y) * (1 - across) + pixel(x + 1, y) * across) * (1 - down) +
           (pixel(x, y + 1) * (1 - across) + pixel(x + 1, y + 1) * across) * down;
}

Vec3 Environment::sample(const Vec2& u, float& density) const {
    density = 0;
    if (empty() || !(rows_.back() > 0)) return Vec3(0, 1, 0);
    float down = 0, across = 0;
    const std::size_t y = find_interval(rows_, u.y, down);
    const std::span<const float> row(columns_.data() + y * width_, width_);
    if (!(row.back() > 0)) return Vec3(0, 1, 0);
    const std::size_t x = find_interval(row, u.x, across);
    const float azimuth =
        2.0F * pi * ((static_cast<float>(x) + across) / static_cast<float>(width_) - 0.5F);
    const float polar = pi * (static_cast<float>(y) + down) / static_cast<float>(height_);
    const float sine = std::sin(polar);
    const Vec3 direction(sine * std::sin(azimuth), std::cos(polar), -sine * std::cos(azimuth));
    density = this->density(direction);
    return direction;
}

float Environment::density(const Vec3& direction) const {
    if (empty() || !(rows_.back() > 0)) return 0;
    const Vec2 at = place_of(direction);
    const auto x = static_cast<std::size_t>(at.x);
    const auto y = static_cast<std::size_t>(at.y);
    const float* row = columns_.data() + y * width_;
    const float in_row = rows_[y] - (y == 0 ? 0.0F : rows_[y - 1]);
    const float weight = row[x] - (x == 0 ? 0.0F : row[x - 1]);
    if (!(row[width_ - 1] > 0) || !(in_row > 0)) return 0;
    const float share = in_row / rows_.back() * (weight / row[width_ - 1]);
    const float sine = std::sqrt(std::max(1.0F - direction.y * direction.y, 1e-12F));
    return share * static_cast<float>(width_) * static_cast<float>(height_) /
           (2.0F * pi * pi * sine);
}

Vec3 Environment::irradiance_up() const {
    glm::dvec3 sum(0);
    for (std::uint32_t y = 0; y < height_ / 2; ++y) {
        const double polar = std::numbers::pi * (y + 0.5) / height_;
        for (std::uint32_t x = 0; x < width_; ++x)
            sum += glm::dvec3(pixels_[std::size_t{y} * width_ + x]) *
                   (std::sin(polar) * std::cos(polar));
    }
    return Vec3(sum * (2 * std::numbers::pi * std::numbers::pi / width_ / height_));
}

}  // namespace raynest
