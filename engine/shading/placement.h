// The transforms of a placement, level by level and as one map, in double: what a hit's position,
// normal and rounding error follow from. Points of a placement come in groups, so the last ones
// that were asked for are kept.
#pragma once

#include "engine/geometry/path.h"
#include "engine/geometry/views.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

namespace raynest {

struct Placement {
    /// The map of one instance from its parent's space, as kernels apply it.
    struct Level {
        glm::dmat3 linear;
        glm::dmat3 inverse;
        glm::dvec3 shift;

        [[nodiscard]] glm::dvec3 point(const glm::dvec3& p) const { return linear * p + shift; }
        [[nodiscard]] glm::dvec3 back(const glm::dvec3& p) const { return inverse * (p - shift); }
        /// With absolute values of all parts: bounds what a sum of products may lose.
        [[nodiscard]] glm::dvec3 magnitude(const glm::dvec3& v) const {
            return glm::abs(linear[0]) * v.x + glm::abs(linear[1]) * v.y +
                   glm::abs(linear[2]) * v.z;
        }
    };

    std::uint64_t path = no_path;
    std::vector<Level> levels;  ///< outermost first
    glm::dmat3 to_object{1};    ///< from the world, without the shift
    glm::dmat3 to_world{1};
    double volume = 1;     ///< volume in the world of a unit cube of the object
    bool mirrors = false;  ///< the object is seen as in a mirror

    void set(const SceneView& scene, std::uint64_t to) {
        path = to;
        levels.clear();
        to_object = to_world = glm::dmat3(1);
        walk_path(scene, to, [&](std::uint32_t index) {
            const std::array<float, 12>& m = scene.instances[index].to_object.m;
            const glm::dmat3 linear(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]);
            const glm::dmat3 inverse = glm::inverse(linear);
            levels.push_back({linear, inverse, {m[9], m[10], m[11]}});
            to_object = linear * to_object;
            to_world = to_world * inverse;
        });
        const double determinant = glm::determinant(to_world);
        volume = std::abs(determinant);
        mirrors = determinant < 0;
    }

    /// A normal of the object, brought to the world, where its length means nothing.
    [[nodiscard]] glm::dvec3 normal(const glm::dvec3& n) const {
        return {glm::dot(to_object[0], n), glm::dot(to_object[1], n), glm::dot(to_object[2], n)};
    }
    /// The world's point that kernels take to a point of the object.
    [[nodiscard]] glm::dvec3 point(glm::dvec3 p) const {
        for (std::size_t i = levels.size(); i-- > 0;) p = levels[i].back(p);
        return p;
    }
};

class PlacementCache {
public:
    [[nodiscard]] const Placement& find(const SceneView& scene, std::uint64_t path) {
        Placement& place = places_[(path ^ path >> 9) % places_.size()];
        if (place.path != path) place.set(scene, path);
        return place;
    }

private:
    std::vector<Placement> places_ = std::vector<Placement>(512);
};

}  // namespace raynest
