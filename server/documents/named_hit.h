// Hits and primitives in JSON documents, with the names that the scene's file has.
#pragma once

#include "engine/geometry/ray.h"
#include "engine/inspection/names.h"
#include "server/documents/json.h"

#include <cstddef>
#include <string>

namespace raynest::server {

/// Writes names of one scene; each has at most `name_bytes` bytes.
class HitNames {
public:
    HitNames(const Snapshot& scene, std::size_t name_bytes)
        : scene_(scene),
          name_bytes_(name_bytes) {}

    /// Returns the keys type, geom, prim and material of a primitive, by its flat index in an
    /// object.
    [[nodiscard]] Json primitive(std::uint32_t object, std::uint32_t flat) const;
    /// Returns what a ray met; null for a miss.
    [[nodiscard]] Json hit(const Ray& ray, const HitRecord& hit) const;
    /// Returns the path of an instance that lies `depth` instances deep.
    [[nodiscard]] std::string placement(const PlacementRange& placements, std::size_t depth) const;
    [[nodiscard]] std::string mesh(std::uint32_t object) const;

private:
    [[nodiscard]] std::string type(const ObjectRecord& object) const;

    const Snapshot& scene_;
    const std::size_t name_bytes_;
};

/// Returns the keys origin, direction, tmin and tmax of a ray, in the world.
[[nodiscard]] Json ray_json(const Ray& ray, const WorldPoint& origin);

}  // namespace raynest::server
