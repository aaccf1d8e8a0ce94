// Light from all around, as a picture: azimuth across, elevation down, -Z in the middle. Directions
// are drawn in proportion to the brightness of the picture.
#pragma once

#include "engine/shading/sampling.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

class Environment {
public:
    Environment() = default;
    /// Row 0 on top; values that are negative or not finite count 0.
    Environment(std::uint32_t width, std::uint32_t height, std::span<const Vec3> pixels);

    [[nodiscard]] bool empty() const { return pixels_.empty(); }
    [[nodiscard]] Vec3 radiance(const Vec3& direction) const;
    /// A direction with its density per solid angle; 0 where the picture is black.
    [[nodiscard]] Vec3 sample(const Vec2& u, float& density) const;
    [[nodiscard]] float density(const Vec3& direction) const;
    /// The irradiance of a surface that faces up.
    [[nodiscard]] Vec3 irradiance_up() const;

private:
    [[nodiscard]] Vec2 place_of(const Vec3& direction) const;
    [[nodiscard]] const Vec3& pixel(int column, int row) const;

    std::uint32_t width_ = 0, height_ = 0;
    std::vector<Vec3> pixels_;
    std::vector<float> rows_;     ///< sums of weights up to and with each row
    std::vector<float> columns_;  ///< of each row the same for its columns
};

}  // namespace raynest
