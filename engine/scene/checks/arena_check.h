// Checks an arena from outside once, so that traversal need not check anything.
#pragma once

#include "engine/geometry/views.h"
#include "engine/result.h"

#include <cstddef>
#include <span>
#include <string>

namespace raynest {

/// Returns the view of a valid arena; otherwise fails with scene_invalid and names the first fault.
/// Afterwards nodes, leaves, instances, paths, attributes and names refer only to their sections,
/// and every tree is a tree: a traversal ends and visits each node once. Linear time.
Result<SceneView> check_arena(std::span<const std::byte> arena);

/// The failure of an arena: scene_invalid, and the fault's name.
[[nodiscard]] tl::unexpected<Error> broken_arena(const std::string& what);

}  // namespace raynest
