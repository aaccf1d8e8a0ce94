// Other user ids for what a scene places.
#pragma once

#include "engine/scene/content.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <span>
#include <vector>

namespace raynest {

/// An outermost instance, and the user id of all that it places from now on.
struct InstanceUid {
    std::uint32_t outermost = 0;
    std::uint32_t uid = 0;
};

/// Instances within the outermost ones of one edit that get a user id, at most.
inline constexpr std::uint64_t nested_uids_max = 1 << 20;

/// Returns how many instances lie within these outermost ones, on all ways; above 2^62 as that.
[[nodiscard]] std::uint64_t nested_instances(const SceneView& view,
                                             std::span<const InstanceUid> uids);

/// Returns the places of all instances within an outermost one that the scene has, from above; more
/// than `most` of them are cut.
[[nodiscard]] std::vector<InstancePlace> places_within(const SceneView& view,
                                                       std::uint32_t outermost, std::uint64_t most);

/// Sets the user ids of `content`, whose nodes name its paths: those of `base`, in its order. `uids`
/// are ascending. A node that stands for several placements is parted, so that each part has one id.
void set_node_uids(const Snapshot& base, std::span<const InstanceUid> uids, Content& content);

}  // namespace raynest
