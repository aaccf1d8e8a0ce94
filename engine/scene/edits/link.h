// Scenes out of parts of scenes. Trees and vertices are copied, not built again:
//
//   kept objects of the base ─┐
//   objects of added scenes  ─┼──► one arena, with a new tree for its root
//   copies of shared objects ─┘
//
// Objects, materials and textures that are there twice, byte for byte, are stored once.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/added_scene.h"
#include "engine/scene/edits/edit_guard.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/edits/uids.h"
#include "engine/scene/snapshot.h"

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// Returns `base` without the outermost instances `removed` (ascending) and with the `added` scenes
/// behind the others. Instances that stay keep the texts of their paths; ids of paths behind
/// removed ones change. A base with primitives of its own becomes an instance of the new root.
/// Costs a copy of the scenes and a build of the root's tree. Fails with field_invalid if an added
/// placement is singular, not finite or reaches beyond coordinate_max, or if own primitives and
/// instances of the root would have to be parted; with limit_exceeded beyond the limits of a scene,
/// path_nodes_max among them; and once the guard stops. Thread-safe. Throws std::bad_alloc.
/// `motion`: tables of the result, in place of the base's (motion/motion.h).
Result<BuiltArena> link_scenes(const Snapshot& base, std::span<const std::uint32_t> removed,
                               std::span<const AddedScene> added, const EditGuard& guard = {},
                               std::vector<std::byte> motion = {});

/// Returns the same scene with objects of their own on the ways to these instances, so that a
/// change there shows at no other place. Ids and texts of paths stay. Where nodes name the paths,
/// they get these user ids (edits/uids.h). Costs a copy of the scene.
Result<BuiltArena> unshare(const Snapshot& base, const std::vector<InstancePlace>& ways,
                           std::span<const InstanceUid> uids = {});

}  // namespace raynest
