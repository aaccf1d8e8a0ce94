// Other user ids for what a scene places.
#pragma once

#include "engine/scene/content.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// An instance, and the user id that it and all within it have from now on.
struct InstanceUid {
    InstancePlace instance;
    std::uint32_t uid = 0;
};

/// Instances within others that get a user id in one edit, at most.
inline constexpr std::uint64_t nested_uids_max = 1 << 20;

/// Returns how many instances within others get a user id, on all ways; above 2^62 as that. The
/// scene has the instances.
[[nodiscard]] std::uint64_t nested_instances(const SceneView& view,
                                             std::span<const InstanceUid> uids);

/// Returns the places of all instances within one that the scene has, from above; more than `most`
/// of them are cut.
[[nodiscard]] std::vector<InstancePlace> places_within(const SceneView& view,
                                                       const InstancePlace& place,
                                                       std::uint64_t most);

/// Sets the user ids of `content`, whose nodes name its paths: those of `base`, in its order. `uids`
/// are ascending; within an instance that has one the inner one counts. A node that stands for
/// several placements is parted, so that each part has one id.
void set_node_uids(const Snapshot& base, std::span<const InstanceUid> uids, Content& content);

}  // namespace raynest
