// Instances by user ids.
#pragma once

#include "engine/result.h"
#include "engine/scene/edits/instance_place.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

namespace raynest {

/// Nested instances that find_uids() looks at, at most.
inline constexpr std::uint64_t uid_instances_max = 1 << 20;

/// Returns for each of these user ids, which ascend without doubles, the instances that have it,
/// those of the scene's nodes that place all of an instance included, in order, without those that
/// lie in another one of the same id. Fails with limit_exceeded beyond uid_instances_max, and once
/// `stopped` is true. In a scene with nodes it looks at each of them, about 10 ns each; in
/// another at the instances that are sought, and at all of a list that may lead to one below it.
[[nodiscard]] Result<std::vector<std::vector<InstancePlace>>> find_uids(
    const Snapshot& scene, std::span<const std::uint32_t> uids,
    const std::function<bool()>& stopped);

}  // namespace raynest
