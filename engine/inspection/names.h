// Names of instances and triangles for people, as the scene's file has them.
#pragma once

#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <string>

namespace raynest {

/// Leaf placements that are reached through the same instances.
struct PlacementRange {
    std::uint64_t first = 0;
    std::uint64_t count = 0;
    [[nodiscard]] bool contains(std::uint64_t path) const { return path - first < count; }
    bool operator==(const PlacementRange&) const = default;
};

/// The path of an instance that lies `depth` instances deep. A scene that was read from nodes names
/// its placements by them, and so an instance by the nodes that all of its placements have in
/// common. Empty where there are none.
[[nodiscard]] std::string instance_path(const Snapshot& scene, const PlacementRange& placements,
                                        std::size_t depth);

/// A primitive by its flat index in an object: glTF primitive, index in that, and material.
struct NamedPrimitive {
    std::uint32_t geom = 0;
    std::uint32_t prim = 0;
    std::uint32_t material = no_id;
};
[[nodiscard]] NamedPrimitive name_primitive(const SceneView& scene, const ObjectRecord& object,
                                            std::uint32_t flat);

}  // namespace raynest
