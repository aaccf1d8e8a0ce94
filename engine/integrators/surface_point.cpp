#include "engine/integrators/surface_point.h"

#include "engine/scene/snapshot.h"

#include <array>
#include <limits>

namespace raynest {
namespace {

using Point = glm::dvec3;

constexpr double eps = std::numeric_limits<float>::epsilon();

/// The linear part by rows, and the shift, of a placement's map from its parent's space.
struct Map {
    glm::dmat3 rows;  ///< rows[i] is row i
    Point shift;

    explicit Map(const InstanceRecord& instance) {
        const Transform by = by_rows(instance.to_object);
        for (int i = 0; i < 3; ++i) {
            const auto at = static_cast<std::size_t>(4 * i);
            rows[i] = {by.m[at], by.m[at + 1], by.m[at + 2]};
            shift[i] = by.m[at + 3];
        }
    }
    [[nodiscard]] Point vector(const Point& v) const {
        return {glm::dot(rows[0], v), glm::dot(rows[1], v), glm::dot(rows[2], v)};
    }
    /// With absolute values of all parts: bounds what a sum of products may lose.
    [[nodiscard]] Point magnitude(const Point& v) const {
        return {glm::dot(glm::abs(rows[0]), v), glm::dot(glm::abs(rows[1]), v),
                glm::dot(glm::abs(rows[2]), v)};
    }
    /// The parent's point that the kernel takes to `p`.
    [[nodiscard]] Point back(const Point& p) const {
        return glm::inverse(glm::transpose(rows)) * (p - shift);
    }
    /// Takes a covector of the object to the parent.
    [[nodiscard]] Point covector(const Point& n) const {
        return n.x * rows[0] + n.y * rows[1] + n.z * rows[2];
    }
};

}  // namespace

SurfacePoint surface_point(const ColumnSource& source, const Ray& ray, const HitRecord& hit) {
    const SceneView& scene = *source.scene;
    SurfacePoint point;
    std::array<const InstanceRecord*, scene_depth_max> way{};
    std::size_t levels = 0;
    walk_path(scene, hit.path, [&](std::uint32_t index) {
        if (levels < way.size()) way[levels++] = &scene.instances[index];
    });

    const ObjectRecord& object = scene.objects[hit.object];
    const Point origin(ray.origin);
    Point error;
    Point normal;  // of the object; its length does not matter
    double extent = 0;
    if (object.triangle_count != 0) {
        const GeometryRecord& geometry = scene.geometry_of(object, hit.triangle);
        const auto* corner = scene.attribute<std::uint32_t>(geometry.indices) +
                             std::size_t{3} * (hit.triangle - geometry.first_triangle);
        const auto* vertices = scene.attribute<Vec3>(geometry.positions);
        const Point v0(vertices[corner[0]]);
        const Point e1 = Point(vertices[corner[1]]) - v0;
        const Point e2 = Point(vertices[corner[2]]) - v0;
        normal = glm::cross(e1, e2);
        extent = glm::length(e1) + glm::length(e2);
        point.position = v0 + static_cast<double>(hit.u) * e1 + static_cast<double>(hit.v) * e2;
        for (std::size_t i = levels; i-- > 0;) point.position = Map(*way[i]).back(point.position);
        error = 2 * eps * glm::abs(point.position);
    } else {
        const Point along = static_cast<double>(hit.t) * Point(ray.direction);
        point.position = origin + along;
        error = 8 * eps * (glm::abs(origin) + glm::abs(along) + glm::abs(point.position));
        normal = Point(0);
    }
    point.normal = world_normal(source, ray, hit);

    // Follow the ray's origin down, as kernels do in float: each level rounds three products and
    // three sums, and stretches the errors from above.
    Point p = point.position;
    for (std::size_t i = 0; i < levels; ++i) {
        const Map map(*way[i]);
        error = map.magnitude(error) + 4 * eps * (map.magnitude(glm::abs(p)) + glm::abs(map.shift));
        p = map.vector(p) + map.shift;
    }
    error += 4 * eps * Point(extent);

    // A world normal times `lift` must clear the error along the object's normal.
    Point world = normal == Point(0) ? Point(point.normal) : glm::normalize(normal);
    const Point unit = world;
    if (normal == Point(0)) {
        // Without vertices: as long as the largest error, brought back to the world.
        double scale = 1;
        Point axis = unit;
        for (std::size_t i = 0; i < levels; ++i) axis = Map(*way[i]).vector(axis);
        if (glm::length(axis) > 0) scale = glm::length(axis);
        point.lift = 2 * glm::length(error) / scale;
        return point;
    }
    for (std::size_t i = levels; i-- > 0;) world = Map(*way[i]).covector(world);
    const double length = glm::length(world);
    point.lift = length > 0 ? 2 * glm::dot(glm::abs(unit), error) / length : 0;
    return point;
}

}  // namespace raynest
