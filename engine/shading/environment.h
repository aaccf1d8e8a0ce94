// Light from all around, as a picture: azimuth across, elevation down. Directions are drawn in
// proportion to the brightness of the picture.
#pragma once

#include "engine/geometry/up_axis.h"
#include "engine/shading/sampling.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

class Environment {
public:
    Environment() = default;
    /// Row 0 on top, at most 65,535 pixels a side; values that are negative or not finite count 0.
    /// Columns go from -Z over +X to +Z; `middle` is the azimuth of the picture's middle from -Z
    /// towards +X, in turns from 0 to below 1.
    Environment(std::uint32_t width, std::uint32_t height, std::span<const Vec3> pixels,
                float middle = 0);
    /// Stands the picture up in a scene with this axis: directions are those of the scene.
    void set_up(UpAxis up) { up_ = up; }

    /// What a direction shows.
    struct View {
        Vec3 radiance{0};
        float density = 0;  ///< density of sample(), per solid angle
    };
    [[nodiscard]] bool empty() const { return texels_.empty(); }
    [[nodiscard]] View view(const Vec3& direction) const;
    [[nodiscard]] Vec3 radiance(const Vec3& direction) const { return view(direction).radiance; }
    [[nodiscard]] float density(const Vec3& direction) const { return view(direction).density; }
    /// Draws a direction, and says what it shows; density 0 where the picture is black.
    [[nodiscard]] Vec3 sample(const Vec2& u, View& view) const;
    [[nodiscard]] Vec3 sample(const Vec2& u, float& density) const {
        View view;
        const Vec3 direction = sample(u, view);
        density = view.density;
        return direction;
    }
    /// Fetches what sample(u) reads, in two steps with other work between them: a picture is larger
    /// than the nearest caches, and the second step depends on what the first one brings.
    void fetch_guide(const Vec2& u) const;
    void fetch_texels(const Vec2& u) const;
    /// The irradiance of a surface that faces up.
    [[nodiscard]] Vec3 irradiance_up() const;

private:
    /// Where a search for an entry of ascending sums begins: for each of as many shares of the
    /// total as there are entries, the entry there.
    class Guide {
    public:
        /// Appends those of one more list of sums, `stride` floats apart.
        void add(const float* sums, std::size_t count, std::size_t stride);
        /// The entry in which u * total falls, and the rest in [0, 1). `list`: number of the list.
        [[nodiscard]] std::size_t find(const float* sums, std::size_t count, std::size_t stride,
                                       std::size_t list, float u, float& rest) const;
        /// Where find() begins.
        [[nodiscard]] const std::uint16_t& first(std::size_t count, std::size_t list,
                                                 float u) const {
            const auto share = static_cast<std::size_t>(u * static_cast<float>(count));
            return first_[list * count + std::min(share, count - 1)];
        }

    private:
        std::vector<std::uint16_t> first_;
    };
    [[nodiscard]] const Vec4& texel(int column, int row) const;
    /// `at` in pixels.
    [[nodiscard]] Vec3 radiance_at(const Vec2& at) const;
    [[nodiscard]] float density_at(std::size_t column, std::size_t row, float sine) const;

    std::uint32_t width_ = 0, height_ = 0;
    float middle_ = 0;
    UpAxis up_ = UpAxis::y;
    /// Radiance, and the sum of weights of its row up to and with it: what one sample reads lies
    /// together.
    std::vector<Vec4> texels_;
    std::vector<float> rows_;  ///< sums of weights up to and with each row
    /// Density of a pixel of each row, times the sine of its angle from the pole, per weight.
    std::vector<float> row_densities_;
    Guide row_guide_, column_guide_;
};

}  // namespace raynest
