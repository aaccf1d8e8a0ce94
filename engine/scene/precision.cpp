#include "engine/scene/precision.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace raynest {
namespace {

/// A shift above this share of the scene's size is worth a warning: a pixel in a picture far larger
/// than any screen.
constexpr double notable_share = 1e-5;

/// A triangle's edge functions are products of two lengths inside it, in float32. If the normal is
/// below the smallest float, they are all 0.
constexpr double normal_min = std::numeric_limits<float>::denorm_min();

bool is_degenerate(const Vec3& a, const Vec3& b, const Vec3& c) {
    const glm::dvec3 v0(a);
    const glm::dvec3 normal = glm::abs(glm::cross(glm::dvec3(b) - v0, glm::dvec3(c) - v0));
    return !(std::max({normal.x, normal.y, normal.z}) >= normal_min);
}

/// Returns a number with few digits near `centre`, at the scale of a scene of this size.
double rounded(double centre, double size) {
    const double step = std::pow(10.0, std::ceil(std::log10(size)));
    return std::round(centre / step) * step + 0.0;
}

}  // namespace

std::uint64_t count_degenerate(const GeometryDescription& geometry) {
    using Part = tbb::blocked_range<std::size_t>;
    constexpr std::size_t part_triangles = 1U << 14;
    const auto corner = [&](std::size_t i) { return geometry.positions[geometry.indices[i]]; };
    return tbb::parallel_reduce(
        Part(0, geometry.indices.size() / 3, part_triangles), std::uint64_t{0},
        [&](const Part& part, std::uint64_t count) {
            for (std::size_t i = part.begin(); i < part.end(); ++i) {
                count +=
                    is_degenerate(corner(3 * i), corner(3 * i + 1), corner(3 * i + 2)) ? 1U : 0U;
            }
            return count;
        },
        [](std::uint64_t a, std::uint64_t b) { return a + b; });
}

std::string rounding_warning(double rounding, const WorldPoint& origin, const Box& bounds) {
    if (bounds.is_empty() || !(rounding > 0)) return {};
    const double size = glm::length(glm::dvec3(bounds.upper) - glm::dvec3(bounds.lower));
    if (!(rounding > notable_share * size)) return {};
    const glm::dvec3 centre = (glm::dvec3(bounds.lower) + glm::dvec3(bounds.upper)) * 0.5 +
                              glm::dvec3(origin[0], origin[1], origin[2]);
    const double grain = std::max(size, rounding);
    return fmt::format(
        "rounding to float32 moves the scene's parts by up to {:.2g}, its size is {:.3g}: load it "
        "with an origin near it, for example `origin` {},{},{}",
        rounding, size, rounded(centre.x, grain), rounded(centre.y, grain),
        rounded(centre.z, grain));
}

}  // namespace raynest
