// Places out of a .npy.
#pragma once

#include "engine/assets/input/import_request.h"
#include "engine/math/matrix.h"
#include "engine/result.h"

#include <vector>

namespace raynest::composition {

/// Reads matrices of shape (N, 3, 4) or (N, 4, 4), or offsets (N, 3). Fails with scene_invalid, and
/// with limit_exceeded beyond instances_max rows.
Result<std::vector<Matrix>> read_matrices(const NamedBytes& file, const ImportLimits& limits);

}  // namespace raynest::composition
