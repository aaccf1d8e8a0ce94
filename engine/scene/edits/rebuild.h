// Trees that are built again because edits have made them slow.
#pragma once

#include "engine/result.h"
#include "engine/scene/snapshot.h"

#include <cstdint>
#include <memory>
#include <span>

namespace raynest {

/// A tree is built again once its expected cost is this many times that of its last build
/// (has_grown()).
inline constexpr double rebuild_cost_factor = 1.2;

/// True for objects whose trees rebuild_trees() can build: of triangles, instances or both, in more
/// than one node. Records stand in the order of their tree, which hits tell.
[[nodiscard]] inline bool can_rebuild(const ObjectRecord& object) {
    return object.node_count > 1 && object.record_count == 0;
}

/// Returns a copy of the scene in which these objects have new trees; ascending. What no longer fits
/// into one tree, or with an alpha texture takes more leaf blocks than before, keeps its own. Costs a look at the whole scene. Thread-safe. Throws std::bad_alloc.
Result<std::shared_ptr<const Snapshot>> rebuild_trees(const Snapshot& scene,
                                                      std::span<const std::uint32_t> objects);

}  // namespace raynest
