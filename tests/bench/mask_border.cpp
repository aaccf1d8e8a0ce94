#include "tests/bench/mask_border.h"

#include "engine/geometry/path.h"
#include "engine/intersectors/texture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

namespace raynest::bench {
namespace {

using Point = glm::dvec3;
using Triangle = std::array<Point, 3>;

Triangle triangle_of(const SceneView& scene, const GeometryRecord& geometry, const HitRecord& hit) {
    Transform to_world;
    walk_path(scene, hit.path, [&](std::uint32_t instance) {
        to_world = compose(to_world, scene.instance_infos[instance].to_parent);
    });
    const auto* corner = scene.attribute<std::uint32_t>(geometry.indices) +
                         std::size_t{3} * (hit.triangle - geometry.first_triangle);
    const auto* positions = scene.attribute<Vec3>(geometry.positions);
    Triangle triangle;
    for (std::size_t i = 0; i < 3; ++i) triangle[i] = to_world.point(positions[corner[i]]);
    return triangle;
}

double largest_coordinate(const Ray& ray, const Triangle& triangle) {
    double largest = 0;
    for (const Point& p : {Point(ray.origin), triangle[0], triangle[1], triangle[2]}) {
        for (int axis = 0; axis < 3; ++axis) largest = std::max(largest, std::abs(p[axis]));
    }
    return largest;
}

/// (u, v) where the line passes the triangle; none beside it.
std::optional<glm::dvec2> crossing(const Point& origin, const Point& direction,
                                   const Triangle& triangle) {
    const Point e1 = triangle[1] - triangle[0];
    const Point e2 = triangle[2] - triangle[0];
    const Point from = origin - triangle[0];
    const Point across = glm::cross(direction, e2);
    const double det = glm::dot(e1, across);
    const double u = glm::dot(from, across) / det;
    const double v = glm::dot(direction, glm::cross(from, e1)) / det;
    if (!(u >= 0 && v >= 0 && u + v <= 1)) return std::nullopt;
    return glm::dvec2(u, v);
}

}  // namespace

bool is_at_mask_border(const SceneView& scene, const Ray& ray, const HitRecord& hit) {
    const GeometryRecord& geometry = scene.geometry_of(scene.objects[hit.object], hit.triangle);
    if (geometry.material == no_id) return false;
    const MaterialRecord& material = scene.materials[geometry.material];
    if (material.alpha_mode == AlphaMode::opaque) return false;
    const float least = material.alpha_mode == AlphaMode::blend ? 0.5F : material.cutoff;
    const Triangle triangle = triangle_of(scene, geometry, hit);
    const Point direction = glm::normalize(Point(ray.direction));
    const Point helper = std::abs(direction.x) < 0.5 ? Point(1, 0, 0) : Point(0, 1, 0);
    const Point x = glm::normalize(glm::cross(helper, direction));
    const Point y = glm::cross(direction, x);
    const double reach = 2 * std::exp2(std::ilogb(largest_coordinate(ray, triangle)) - 23);

    constexpr int samples = 16;
    bool solid = false;
    bool hole = false;
    for (int i = 0; i < samples; ++i) {
        const double turn = 2 * std::numbers::pi * i / samples;
        const Point beside = Point(ray.origin) + reach * (std::cos(turn) * x + std::sin(turn) * y);
        const auto uv = crossing(beside, direction, triangle);
        if (!uv) continue;
        const float alpha = surface_alpha(scene, geometry, material, hit.triangle,
                                          static_cast<float>(uv->x), static_cast<float>(uv->y));
        (alpha >= least ? solid : hole) = true;
    }
    return solid && hole;
}

}  // namespace raynest::bench
