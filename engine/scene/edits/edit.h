// Changes of a built scene: outermost instances move, and their masks change.
//
//   snapshot ──edit_scene──► the next snapshot
//
// The objects stay as they are. The tree of the root is refitted: the boxes above what moved are made
// anew and all others stay. Rays hit what they would hit in the same scene loaded afresh, bit for bit;
// they may visit other boxes on their way. When the refitted tree's expected cost has grown by a fifth
// since the tree was built, it is built again.
#pragma once

#include "engine/math/vec.h"
#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <memory>
#include <span>

namespace raynest {

/// An outermost instance, by its place in the root, and where it stands from now on.
struct InstanceMove {
    std::uint32_t instance = 0;
    Transform to_scene;
};

/// An outermost instance and its mask from now on; with 0 no ray enters it.
struct InstanceMask {
    std::uint32_t instance = 0;
    std::uint32_t mask = 0xFFFFFFFFU;
};

/// The root's tree is built again once its expected cost is this many times that of its last build.
inline constexpr double rebuild_cost_factor = 1.2;

/// Returns a changed copy of the scene. `spare` may be the scene before its last edit: if nobody else
/// refers to it, its memory becomes that of the copy, and an edit costs what it changes. Fails with field_invalid for an instance that the scene
/// lacks or that is named twice, and for a placement that is singular, not finite or reaches beyond
/// coordinate_max; names the instance by its path. Thread-safe. Costs a copy of what
/// differs, a look at each node, and what moved. Throws std::bad_alloc.
Result<std::shared_ptr<const Snapshot>> edit_scene(const Snapshot& scene,
                                                   std::span<const InstanceMove> moves,
                                                   std::span<const InstanceMask> masks,
                                                   std::shared_ptr<const Snapshot> spare = nullptr);

}  // namespace raynest
