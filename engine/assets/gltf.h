// glTF 2.0 import, as CONTRACT.md §6 says. How the files work together: gltf_model.h.
#pragma once

#include "engine/assets/import.h"

namespace raynest {

/// `request.files[0]` is a .glb or .gltf, the others are what it names. Bytes of any content end in
/// a description or an error; no file outside the request is opened.
Result<SceneDescription> describe_gltf(const ImportRequest& request, const ImportLimits& limits);

}  // namespace raynest
