// Checks that a description is consistent. Importers read hostile files; this second check lets the
// builder use indices without checking them.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

namespace raynest {

/// Fails with scene_invalid and names the first inconsistency: an index out of range, attributes of
/// unequal length, an image that is not width x height, a non-finite number, coordinates that are
/// not finite or beyond coordinate_max (with their count). resolve_graph() checks the graph of
/// instances.
Result<void> check_description(const SceneDescription& description);

}  // namespace raynest
