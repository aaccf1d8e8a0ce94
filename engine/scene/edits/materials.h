// Other materials for meshes that a scene places.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/edited_arena.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/shading/records.h"

#include <cstdint>
#include <string_view>
#include <vector>

namespace raynest {

/// The object of an instance, whose triangles have this material from now on.
struct MeshMaterial {
    InstancePlace instance;
    std::uint32_t material = 0;
};

/// Meshes that one edit gives other materials, at most.
inline constexpr std::uint64_t edited_meshes_max = 1 << 20;

/// Returns the material of a name; else that of a number, as the column `material` has it. Fails
/// with field_invalid if the scene has none, or several of the name.
Result<std::uint32_t> find_material(const SceneView& view, std::string_view text);

/// Returns how many meshes each object places, on all ways, itself included if it has triangles.
std::vector<std::uint64_t> count_meshes(const SceneView& view);

/// Returns an instance and all instances within it whose objects have triangles. The scene has the
/// instance, and `counts` are those of count_meshes(): the meshes cost a look at what lies above
/// them, however much else is placed beside them.
std::vector<InstancePlace> meshes_of(const SceneView& view, const InstancePlace& place,
                                     const std::vector<std::uint64_t>& counts);

/// Returns why an object's triangles cannot have the material; "" if they can. What of a material
/// the tree holds cannot change: whether rays may pass through.
std::string_view why_not(const ShadingView& shading, const ObjectRecord& object,
                         std::uint32_t material);

/// Gives all triangles of an object a material.
void set_material(EditedArena& arena, const ObjectRecord& object, std::uint32_t material);

}  // namespace raynest
