#include "engine/inspection/names.h"

#include <algorithm>

namespace raynest {

std::string instance_path(const Snapshot& scene, const PlacementRange& placements,
                          std::size_t depth) {
    if (placements.count == 0) return {};
    auto steps = expand_path(scene, placements.first);
    if (!steps) return {};
    std::size_t shared = std::min(depth, steps->size());
    if (scene.paths().node_count != 0) {
        const auto last = expand_path(scene, placements.first + placements.count - 1);
        if (!last) return {};
        const auto same = [](const PathStep& a, const PathStep& b) { return a.name == b.name; };
        const auto end =
            std::mismatch(steps->begin(), steps->end(), last->begin(), last->end(), same).first;
        shared = static_cast<std::size_t>(end - steps->begin());
    }
    steps->resize(shared);
    return path_name(*steps);
}

NamedPrimitive name_primitive(const SceneView& scene, const ObjectRecord& object,
                              std::uint32_t flat) {
    if (object.triangle_count == 0) return {0, flat, no_id};
    const GeometryRecord& geometry = scene.geometry_of(object, flat);
    const GeometryRecord* first = scene.geometries + object.first_geometry;
    return {static_cast<std::uint32_t>(&geometry - first), flat - geometry.first_triangle,
            geometry.material};
}

}  // namespace raynest
