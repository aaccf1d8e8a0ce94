// Changes of a built scene: instances move, their masks change, meshes deform, some go and others
// come.
//
//   snapshot ──edit_scene──► the next snapshot
//
// Objects stay as they are but for vertices. The trees on the way from what moved to the root are
// refitted: the boxes above it are made anew and all others stay. What is placed several times and
// changes at one place gets objects of its own there first. Rays hit what they would hit in the
// same scene loaded afresh, bit for bit; they may visit other boxes on their way. A refitted tree
// whose expected cost has grown by a fifth since it was built is built again (rebuild.h); so is the
// root's when instances come or go.
#pragma once

#include "engine/math/vec.h"
#include "engine/result.h"
#include "engine/scene/edits/deform.h"
#include "engine/scene/edits/edit_guard.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/edits/link.h"
#include "engine/scene/edits/materials.h"
#include "engine/scene/edits/uids.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <memory>
#include <vector>

namespace raynest {

/// An instance, and where it stands from now on.
struct InstanceMove {
    InstancePlace instance;
    Transform to_parent;  ///< to the space of the object that places it
};

/// An instance and its mask from now on; with 0 no ray enters it.
struct InstanceMask {
    InstancePlace instance;
    std::uint32_t mask = 0xFFFFFFFFU;
};

/// The object of an instance, and where its vertices are from now on.
struct MeshVertices {
    InstancePlace instance;
    NewVertices vertices;
};

/// A camera, by its index, and its pose from now on (scene/camera_pose.h).
struct CameraMove {
    std::uint32_t camera = 0;
    Transform to_world;
};

struct LightMove {
    std::uint32_t light = 0;
    Vec3 position{0};
    Vec3 direction{0, 0, -1};  ///< unit vector, away from the light
};

struct SceneChanges {
    std::vector<InstanceMove> moves = {};
    std::vector<InstanceMask> masks = {};
    std::vector<std::uint32_t> removed = {};  ///< outermost instances, ascending
    std::vector<AddedScene> added = {};
    std::vector<MeshVertices> deformed = {};
    std::vector<CameraMove> cameras = {};
    std::vector<LightMove> lights = {};
    std::vector<InstanceUid> uids = {};  ///< ascending: what lies within another comes behind it
    std::vector<MeshMaterial> materials = {};
    bool is_last = false;  ///< no edit follows this one: it gets a whole arena, on huge pages
};

/// Returns a changed copy of the scene. `spare` may be the scene before its last edit: if nobody
/// else refers to it, its memory becomes that of the copy, and an edit costs what it changes. Fails
/// with field_invalid for an instance that the scene lacks or that is named twice, for a placement
/// that is singular, not finite or reaches beyond coordinate_max, and as link_scenes() does; names
/// the instance by its path; and with limit_exceeded beyond nested_uids_max. Asks the guard for all that
/// it takes beside an edited copy of the scene (shared_ways.h), and fails as that does. User ids of a scene whose
/// nodes name its paths cost a copy of it. Thread-safe. Moves cost a copy of what differs, what moved and
/// a look at the nodes above it; masks within groups a look at what stands beside them, until one of
/// these sees all rays; the rest costs what link_scenes() and unshare() cost. Throws std::bad_alloc.
Result<std::shared_ptr<const Snapshot>> edit_scene(const Snapshot& scene,
                                                   const SceneChanges& changes,
                                                   std::shared_ptr<const Snapshot> spare = nullptr,
                                                   const EditGuard& guard = {});

}  // namespace raynest
