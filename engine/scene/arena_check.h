// Checks an arena that came from outside, once, so that traversal need not check anything.
#pragma once

#include "engine/geometry/views.h"
#include "engine/result.h"

#include <cstddef>
#include <span>

namespace raynest {

/// The view of a sound arena; scene_invalid naming the first thing that is not. After it no walk
/// over nodes, leaves, instances, paths, attributes or names leaves its section, and every tree is
/// a tree: a walk ends, and visits each node once. Linear time.
Result<SceneView> check_arena(std::span<const std::byte> arena);

}  // namespace raynest
