// NumPy arrays as scenes: one record of a primitive type per row, and optional placements.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/packs/registry.h"
#include "engine/result.h"
#include "engine/scene/description.h"

namespace raynest {

/// Describes a scene from arrays. files[0]: float32 or float64, C order, shape (N, K) with 4 K =
/// the record size of `request.primitive`. files[1], optional: (M, 12) or (M, 3, 4) row-major 3x4
/// object-to-world matrices. Values that are not finite as float32 are refused, with a count.
/// Before rounding, the request's origin is subtracted from the placements or, without any, from
/// the first three values of each record. scene_unsupported if those are not the record's position.
Result<SceneDescription> describe_npy(const ImportRequest& request, const ImportLimits& limits,
                                      const Registry& registry);

}  // namespace raynest
