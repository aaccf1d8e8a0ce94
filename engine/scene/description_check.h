// Is a description consistent? Importers read hostile files; what they hand over is checked here
// once more, so that building can index without looking.
#pragma once

#include "engine/result.h"
#include "engine/scene/description.h"

namespace raynest {

/// scene_invalid naming the first inconsistency: an index out of range, attributes of unequal
/// length, an image that is not width x height, a non-finite number, coordinates that are not
/// finite or beyond coordinate_max (with their count). The graph of instances is resolve_graph's
/// matter.
Result<void> check_description(const SceneDescription& description);

}  // namespace raynest
