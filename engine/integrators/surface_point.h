// Where a ray leaves a surface: a point, and the distance from it that rounding cannot undo.
#pragma once

#include "engine/queries/columns.h"
#include "engine/shading/placement.h"

namespace raynest {

struct SurfacePoint {
    /// On the surface, as the kernels' transforms place it; of a triangle, some rounding errors
    /// away from its edges.
    glm::dvec3 position{0};
    Vec3 normal{0};  ///< geometric and outward, unit length; 0 where a type has none
    /// A ray that starts so far from the surface, along the normal, does not meet it again. The
    /// bound follows the rounding of the vertices, of the origin and of each transform on the way
    /// down to the object.
    double lift = 0;
    double twice_area = 0;  ///< for a triangle, in the world

    /// The origin of a ray that leaves on the side of `direction`, `shift` away from the surface.
    [[nodiscard]] Vec3 origin(const Vec3& direction, const Vec3& shift = Vec3(0)) const {
        const double side = glm::dot(normal, direction) < 0 ? -lift : lift;
        return Vec3(position + glm::dvec3(shift) + side * glm::dvec3(normal));
    }
};

/// The surface of a closest hit, whose placement is hit.path. Its place follows from the vertices;
/// where a primitive has none, from the ray.
[[nodiscard]] SurfacePoint surface_point(const ColumnSource& scene, const Ray& ray,
                                         const HitRecord& hit, const Placement& placement);
[[nodiscard]] SurfacePoint surface_point(const ColumnSource& scene, const Ray& ray,
                                         const HitRecord& hit);

}  // namespace raynest
