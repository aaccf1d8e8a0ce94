#include "engine/scene/precision.h"

#include "engine/math/float_step.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace raynest {
namespace {

/// A shift above this share of the scene's size is worth a warning: a pixel in a picture far larger
/// than any screen.
constexpr double notable_share = 1e-5;

/// The same for rays that leave surfaces: clients warn of the rays of queries from this share on.
constexpr double notable_share_of_rays = 1e-4;

/// A triangle's edge functions are products of two lengths inside it, in float32. If the normal is
/// below the smallest float, they are all 0.
constexpr double normal_min = std::numeric_limits<float>::denorm_min();

/// Returns a number with few digits near `centre`, at the scale of a scene of this size.
double rounded(double centre, double size) {
    const double step = std::pow(10.0, std::ceil(std::log10(size)));
    return std::round(centre / step) * step + 0.0;
}

/// Returns an origin near a scene: "X,Y,Z".
std::string near_origin(const WorldPoint& origin, const Box& bounds, double grain) {
    const glm::dvec3 centre = (glm::dvec3(bounds.lower) + glm::dvec3(bounds.upper)) * 0.5 +
                              glm::dvec3(origin[0], origin[1], origin[2]);
    return fmt::format("{},{},{}", rounded(centre.x, grain), rounded(centre.y, grain),
                       rounded(centre.z, grain));
}

double size_of(const Box& bounds) {
    return glm::length(glm::dvec3(bounds.upper) - glm::dvec3(bounds.lower));
}

}  // namespace

bool is_degenerate(const Vec3& a, const Vec3& b, const Vec3& c) {
    const glm::dvec3 v0(a);
    const glm::dvec3 normal = glm::abs(glm::cross(glm::dvec3(b) - v0, glm::dvec3(c) - v0));
    return !(std::max({normal.x, normal.y, normal.z}) >= normal_min);
}

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

double half_step(const Vec3& point) {
    glm::dvec3 off(0);
    for (int axis = 0; axis < 3; ++axis) {
        if ((std::bit_cast<std::uint32_t>(point[axis]) & 1U) != 0)
            off[axis] = float_step(point[axis]) / 2;
    }
    return glm::length(off);
}

std::string rounding_warning(const SceneDescription& scene, const Box& bounds) {
    const double moved = std::max(scene.rounding, scene.file_rounding);
    if (bounds.is_empty() || !(moved > 0)) return {};
    const double size = size_of(bounds);
    if (!(moved > notable_share * size)) return {};
    const std::string near = near_origin(scene.origin, bounds, std::max(size, moved));
    if (scene.rounding > notable_share * size)
        return fmt::format(
            "rounding to float32 moves the scene's parts by up to {:.2g}, its size is "
            "{:.3g}: load it with an origin near it, for example `origin` {}",
            scene.rounding, size, near);
    return fmt::format(
        "float32 coordinates of the file are so far from zero that rounding has moved them by "
        "up to {:.2g}, the scene's size is {:.3g}: write them relative to a point near "
        "it, for example {}, with that point as the translation of their node, and "
        "load it with `origin` {}",
        scene.file_rounding, size, near, near);
}

std::string light_warning(const WorldPoint& origin, const Box& bounds) {
    if (bounds.is_empty()) return {};
    const double size = size_of(bounds);
    const Vec3 corner = glm::max(glm::abs(bounds.lower), glm::abs(bounds.upper));
    const float farthest = std::max({corner.x, corner.y, corner.z});
    const double step = float_step(farthest);
    if (!(size > 0) || !(step / 2 > notable_share_of_rays * size)) return {};
    return fmt::format(
        "light starts beside the surfaces that it leaves: so far from the scene's origin float32 "
        "has steps of {:.2g}, and the scene's size is {:.3g}. Shadows and edges are off by several "
        "steps; load the scene with an origin near it, for example `origin` {}",
        step, size, near_origin(origin, bounds, std::max(size, step)));
}

}  // namespace raynest
