#include "engine/integrators/surface_point.h"

#include <algorithm>
#include <limits>

namespace raynest {
namespace {

using Point = glm::dvec3;

constexpr double eps = std::numeric_limits<float>::epsilon();

/// Where two walls meet, a ray that starts on the plane of the other wall, or beyond it, does not
/// meet that wall: light would leak in along the edges of a closed box. Returns how far, as a share
/// of the way, a point of a triangle moves towards the triangle's middle, so that it lies some
/// `reach` from the edges; 0 for points farther inside. `normal` is e1 x e2.
double inset(const Point& e1, const Point& e2, const Point& normal, double extent, double u,
             double v, double reach) {
    // A height of the triangle is |normal| over an edge, and no edge is longer than `extent`.
    const double nearest = std::min({u, v, 1 - u - v});
    const double limit = reach * extent;
    if (nearest * nearest * glm::dot(normal, normal) >= limit * limit) return 0;
    // Towards an edge of an acute corner the way to the middle comes nearer by a third of itself.
    constexpr double way = 4;
    const double left = glm::length((1.0 / 3 - u) * e1 + (1.0 / 3 - v) * e2);
    return left > way * reach ? way * reach / left : 1;
}

}  // namespace

SurfacePoint surface_point(const ColumnSource& source, const Ray& ray, const HitRecord& hit,
                           const Placement& placement) {
    const SceneView& scene = *source.scene;
    SurfacePoint point;
    const ObjectRecord& object = scene.objects[hit.object];
    const Point origin(ray.origin);
    Point error;
    Point normal(0);  // the object's normal, as long as twice the triangle's area there
    Point world(0);   // the same in the world, where its length is how the levels stretch it
    Point v0(0), e1(0), e2(0);  // a triangle's corner and edges from it
    double extent = 0;
    if (object.triangle_count != 0) {
        const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
        const auto* corner = scene.attribute<std::uint32_t>(geometry.indices) +
                             std::size_t{3} * (hit.triangle - geometry.first_triangle);
        const auto* vertices = scene.attribute<Vec3>(geometry.positions);
        v0 = Point(vertices[corner[0]]);
        e1 = Point(vertices[corner[1]]) - v0;
        e2 = Point(vertices[corner[2]]) - v0;
        extent = glm::length(e1) + glm::length(e2);
        normal = glm::cross(e1, e2);
        world = placement.normal(normal);
        point.position =
            placement.point(v0 + static_cast<double>(hit.u) * e1 + static_cast<double>(hit.v) * e2);
        error = 2 * eps * glm::abs(point.position);
        const double length = glm::length(world);
        if (length > 0) point.normal = Vec3(world / length);
        point.twice_area = length * placement.volume;
    } else {
        const Point along = static_cast<double>(hit.t) * Point(ray.direction);
        point.position = origin + along;
        error = 8 * eps * (glm::abs(origin) + glm::abs(along) + glm::abs(point.position));
        point.normal = world_normal(source, ray, hit);
    }

    // Follow the ray's origin down, as kernels do in float: each level rounds three products and
    // three sums, and stretches the errors from above.
    Point p = point.position;
    for (const Placement::Level& level : placement.levels) {
        error = level.magnitude(error) +
                4 * eps * (level.magnitude(glm::abs(p)) + glm::abs(level.shift));
        p = level.point(p);
    }
    error += 4 * eps * Point(extent);

    // A world normal times `lift` must clear the error along the object's normal.
    if (object.triangle_count == 0) {
        // Without vertices: as long as the largest error, brought back to the world.
        const double scale = glm::length(placement.to_object * Point(point.normal));
        point.lift = 2 * glm::length(error) / (scale > 0 ? scale : 1);
        return point;
    }
    const auto u = static_cast<double>(hit.u), v = static_cast<double>(hit.v);
    const double reach = 2 * (error.x + error.y + error.z);
    if (const double share = inset(e1, e2, normal, extent, u, v, reach); share > 0)
        point.position = placement.point(v0 + (u + share * (1.0 / 3 - u)) * e1 +
                                         (v + share * (1.0 / 3 - v)) * e2);
    const double stretch = glm::length(world);
    point.lift = stretch > 0 ? 2 * glm::dot(glm::abs(normal), error) / stretch : 0;
    return point;
}

SurfacePoint surface_point(const ColumnSource& source, const Ray& ray, const HitRecord& hit) {
    Placement placement;
    placement.set(*source.scene, hit.path);
    return surface_point(source, ray, hit, placement);
}

}  // namespace raynest
