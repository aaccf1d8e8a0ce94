// The objects that an edit copies, for they lie in several places and change at one, and their bytes.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/edit_guard.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// The objects and instances on a way down: indices in SceneView::objects and SceneView::instances.
struct WayStep {
    std::uint32_t object;
    std::uint32_t instance;
};

/// Returns the steps to an instance; empty if the scene lacks it.
[[nodiscard]] std::vector<WayStep> steps_to(const SceneView& view, const InstancePlace& place);

/// Returns the object of an instance that the scene has.
[[nodiscard]] std::uint32_t object_of(const SceneView& view, const InstancePlace& place);

/// Returns the ways on which shared objects change, a step longer where the last one's object does.
/// The scene has the instances that the changes name, and the changes keep the limits of
/// edit_scene(). Fails as the guard does.
[[nodiscard]] Result<std::vector<InstancePlace>> shared_ways(const Snapshot& scene,
                                                             const SceneChanges& changes,
                                                             const EditGuard& guard = {});

/// Returns how many bytes it takes at most to copy what lies on the shared ways.
[[nodiscard]] std::uint64_t bytes_to_unshare(const Snapshot& scene,
                                             std::vector<InstancePlace> ways);

/// Returns how many bytes an edit takes at most while it is made, beside an edited copy of the
/// scene. Costs a look at each instance of the scene.
[[nodiscard]] std::uint64_t bytes_beside(const Snapshot& scene, const SceneChanges& changes,
                                         const std::vector<InstancePlace>& ways);

}  // namespace raynest
