// Colours of primitives other than triangles: of the points of a cloud.
#pragma once

#include "engine/geometry/views.h"

#include <cstdint>

namespace raynest {

/// Four bytes for each record of an object, by its original index: sRGB, and an alpha that nothing
/// tests. They lie where an object's first geometry, which then has no triangles, has the colours of
/// its vertices. Null where the records have none.
[[nodiscard]] inline const std::uint8_t* record_colours(const SceneView& scene,
                                                        const ObjectRecord& object) {
    if (object.record_count == 0 || object.geometry_count == 0) return nullptr;
    const GeometryRecord& geometry = scene.geometries[object.first_geometry];
    return geometry.colours != no_offset && geometry.vertex_count == object.record_count
               ? scene.attribute<std::uint8_t>(geometry.colours)
               : nullptr;
}

}  // namespace raynest
